"""The network of SPEC section 2 a second time, in plain NumPy with SciPy's minimiser: shares no code with the package.

Effects are the exception: their hooks are evaluated with numbers instead of symbols, so what is independent there is
everything around the hooks (assembly, solver, derivatives), not the effect's own formula.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations

import casadi as ca
import numpy as np
from scipy.optimize import minimize

from tepm_opt.models.effect import BEGAN, CLOCK, Context, Effect, Properties
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import load_robot

KANG = {"L_0": 0.2, "r": 0.04, "A": 50.27e-6, "m_d": 0.22, "K_a": 358.86, "alpha_1": 70.0, "alpha_2": 1.0}
ANGLES = tuple(np.deg2rad([90.0, 210.0, 330.0]))
BASE = np.array([0.0, 0.0, -0.05])
UP = np.array([0.0, 0.0, 1.0])


@dataclass
class Network:
    """Masses and springs as arrays, one entry an edge or a node; edges run level by level in the order of `kinds`."""

    modules: int = 2
    segments: int = 6
    angles: tuple[float, ...] = ANGLES
    crossed: bool = True
    gravity: float = 9.81
    parameters: dict[str, float] = field(default_factory=dict)

    def __post_init__(self):
        value, m = KANG | self.parameters, len(self.angles)
        n = self.modules * self.segments
        ring = [(value["r"] * np.cos(a), value["r"] * np.sin(a), 0) for a in self.angles]
        self.rest_nodes = np.array([[np.array(node) + UP * (k * value["L_0"] / self.segments) for node in ring] for k in range(n + 1)])
        around = sorted(range(m), key=lambda i: self.angles[i] % (2 * np.pi))
        faces = [(around[i], around[(i + 1) % m]) for i in range(m)]
        one_way = [(0, i, 1, j) for i, j in faces]
        other_way = [(0, j, 1, i) for i, j in faces] if self.crossed else []
        self.kinds = [(0, i, 1, i) for i in range(m)] + [(1, i, 1, j) for i, j in combinations(range(m), 2)] + one_way + other_way
        factor = [1.0] * m + [value["alpha_1"]] * (m * (m - 1) // 2) + [value["alpha_2"]] * (len(faces) * (1 + self.crossed))
        self.ends = np.array([[(k + p) * m + i for p, i in ((p, i), (q, j))] for k in range(n) for p, i, q, j in self.kinds])
        span = np.diff(self.rest_nodes.reshape(-1, 3)[self.ends], axis=1)[:, 0]
        self.rest = np.linalg.norm(span, axis=1).reshape(n, -1)
        self.stiffness = np.tile(np.array(factor) * self.segments * value["K_a"], (n, 1))
        self.mass = np.full(n, value["m_d"] / (m * self.segments))  # of one node of the level, Eq. (2)
        self.area, self.levels, self.actuators = value["A"], n, m
        self.laws = []  # (index in `kinds`, function of lengths and rest lengths → energy, slope, curvature)

    def push(self, inputs):
        """F_a = p A - lambda of every vertical edge (levels, actuators), Eq. (3)."""
        pressure, tension = np.asarray(inputs, dtype=float).reshape(2, self.modules, self.actuators)
        return np.repeat(self.area * pressure - tension, self.segments, axis=0)

    def potential(self, x, push, load):
        """Energy, gradient and Hessian for free nodes x; `load` is the force on every node (levels, 3)."""
        m, size = self.actuators, x.size
        nodes = np.concatenate([self.rest_nodes[0], x.reshape(-1, 3)])
        span = nodes[self.ends[:, 1]] - nodes[self.ends[:, 0]]
        length = np.linalg.norm(span, axis=1)
        along = span / length[:, None]
        stretch = length.reshape(self.levels, -1) - self.rest
        value, slope, curvature = self.stiffness * stretch**2 / 2, self.stiffness * stretch, self.stiffness.copy()
        value[:, :m] -= push * length.reshape(self.levels, -1)[:, :m]
        slope[:, :m] -= push
        for index, law in self.laws:
            added = law(length.reshape(self.levels, -1)[:, index], self.rest[:, index])
            for total, part in zip((value, slope, curvature), added, strict=True):
                total[:, index] += part
        energy = value.sum() - (np.repeat(load, m, axis=0) * nodes[m:]).sum()
        pull = slope.ravel()[:, None] * along
        gradient = np.zeros_like(nodes)
        np.add.at(gradient, self.ends[:, 1], pull)
        np.add.at(gradient, self.ends[:, 0], -pull)
        gradient = gradient[m:] - np.repeat(load, m, axis=0)
        across = (slope.ravel() / length)[:, None, None]
        outer = along[:, :, None] * along[:, None, :]
        blocks = (curvature.ravel()[:, None, None] - across) * outer + across * np.eye(3)
        hessian = np.zeros((len(nodes), 3, len(nodes), 3))
        for sign, i, j in ((1, 0, 0), (1, 1, 1), (-1, 0, 1), (-1, 1, 0)):
            np.add.at(hessian.transpose(0, 2, 1, 3), (self.ends[:, i], self.ends[:, j]), sign * blocks)
        return energy, gradient.ravel(), hessian[m:, :, m:, :].reshape(size, size)

    def loads(self, tip_force=(0.0, 0.0, 0.0)):
        """Weight and tip force on every node of the free levels (levels, 3)."""
        load = -UP * self.gravity * self.mass[:, None]
        load[-1] += np.asarray(tip_force) / self.actuators
        return load

    def solve(self, push, load, start=None):
        """Nodes (levels + 1, actuators, 3) in the base frame at the potential's minimum, and the smallest eigenvalue there."""
        start = (self.rest_nodes if start is None else start)[1:].ravel()
        found = minimize(
            lambda x: self.potential(x, push, load)[:2], start, jac=True, hess=lambda x: self.potential(x, push, load)[2],
            method="trust-exact", options={"initial_trust_radius": 0.1, "max_trust_radius": 0.3, "gtol": 1e-4, "maxiter": 1000},
        )  # fmt: skip
        x = found.x
        for _ in range(6):  # the minimiser stops early; Newton ends at the rounding noise of the force
            _, gradient, hessian = self.potential(x, push, load)
            x = x - np.linalg.solve(hessian, gradient)
        assert np.abs(self.potential(x, push, load)[1]).max() < 1e-9, found.message
        nodes = np.concatenate([self.rest_nodes[0], x.reshape(-1, 3)]).reshape(self.levels + 1, self.actuators, 3)
        return nodes, float(np.linalg.eigvalsh(self.potential(x, push, load)[2])[0])

    def points(self, nodes):
        """Reference points in G at half and full height of every module."""
        centres = nodes.mean(axis=1)
        heights = np.arange(1, 2 * self.modules + 1) * self.segments / 2
        return BASE + np.array([(centres[int(np.floor(h))] + centres[int(np.ceil(h))]) / 2 for h in heights])

    def lengths(self, nodes):
        """Actuator lengths (modules, actuators)."""
        return np.linalg.norm(np.diff(nodes, axis=0), axis=2).reshape(self.modules, self.segments, -1).sum(axis=1)


def solve_with_effect(effect: Effect, parameters, detail, inputs, tip_force, start, time=0.0):
    """Reference points of kang2017 with an effect, as measured when a run begins at a time in the session."""
    network, layout = Network(), Layout.from_robot(load_robot("kang2017"))
    assert [(*edge.a, *edge.b) for edge in layout.edges] == network.kinds
    context = Context(layout, detail, np.eye(3), BASE, -network.gravity * UP)
    own = {name: ca.SX(float(value)) for name, value in {**parameters, CLOCK: time, BEGAN: time}.items()}
    pressure, tension = (ca.SX(ca.DM(part)) for part in np.reshape(inputs, (2, network.modules, network.actuators)))
    pressure, tension = effect.inputs(pressure, tension, own, context)
    begun = effect.pressure_begun(ca.repmat(pressure, effect.branches, 1), own, context)
    pressure = pressure + sum(ca.vertsplit(begun, network.modules))
    damping = np.full(network.rest.T.shape, 15.50)
    arrays = (ca.SX(ca.DM(array)) for array in (network.stiffness.T, damping, network.rest.T, network.mass))
    properties = Properties(*arrays, pressure, tension)
    effect.properties(properties, own, context)
    network.stiffness, network.rest = _numbers(properties.stiffness).T, _numbers(properties.rest).T
    network.mass = _numbers(properties.mass).ravel()
    external = np.zeros((3, layout.points))
    external[:, -1] = tip_force
    added = _numbers(effect.loads(properties, ca.SX(ca.DM(external)), own, context)).T
    for index, edge in enumerate(layout.edges if effect.has("edge_energy") else ()):
        length, rest = ca.SX.sym("length"), ca.SX.sym("rest")
        energy = ca.SX(effect.edge_energy(edge, length, rest, own, context))
        slope = ca.gradient(energy, length)
        law = ca.Function("law", [length, rest], [energy, slope, ca.gradient(slope, length)])
        network.laws.append((index, lambda at, rest, law=law: [np.array(part).ravel() for part in law(at[None], rest[None])]))
    tensions = _numbers(properties.tension).repeat(layout.segments, axis=0)
    for index in range(layout.actuators if effect.has("tendon_energy") else 0):
        length, rest, tension = (ca.SX.sym(name) for name in ("length", "rest", "tension"))
        energy = ca.SX(effect.tendon_energy(length, rest, tension, own, context))
        slope = ca.gradient(energy, length)
        law = ca.Function("law", [length, rest, tension], [energy, slope, ca.gradient(slope, length)])
        network.laws.append(
            (index, lambda at, rest, law=law, of=tensions[:, index]: [np.array(p).ravel() for p in law(at[None], rest[None], of[None])])
        )
    actuation = np.concatenate([_numbers(properties.pressure).ravel(), _numbers(properties.tension).ravel()])
    nodes, _ = network.solve(network.push(actuation), network.loads(tip_force) + added / network.actuators, start)
    return _numbers(effect.outputs(ca.SX(ca.DM(network.points(nodes).T)), own, context)).T


def _numbers(values):
    return np.array(ca.evalf(ca.densify(values)))

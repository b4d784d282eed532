"""The symbols a model is written with: parameters, inputs, properties, the nodes and edges of one segment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from tepm_opt.models.effect import BEGAN, CLOCK, Context, Effect, Properties
from tepm_opt.models.effects import STANDARD, find_effect
from tepm_opt.models.layout import HORIZONTAL, VERTICAL, Edge, Layout
from tepm_opt.models.model import Model

RAIL = 100.0  # strength of a guide over that of a segment's muscles
SOFT = 1.0  # N/m, of a muscle more, so that rails hold where the muscles have no stiffness
PROPERTY_ROWS = ("stiffness", "damping", "rest", "axial", "tension", "load", "number", "mass")
"""Rows of P: of every edge (three times), axial force of every vertical edge, tension in it where an effect asks for it,
force on a node of the upper level, number of the segment from 0 where forces on points depend on their motion, mass of a node of the
upper level."""
POINT_HOOKS = ("point_energy", "point_drag")


def property_rows(layout: Layout, strung: bool, numbered: bool) -> dict[str, slice]:
    """Rows of each property in the column that holds them all; `strung`, `numbered`: whether tensions and segments' numbers are there."""
    edges, actuators = len(layout.edges), layout.actuators
    sizes = dict(zip(PROPERTY_ROWS, (edges, edges, edges, actuators, strung * actuators, 3, int(numbered), 1), strict=True))
    ends = np.cumsum(list(sizes.values()))
    return {name: slice(int(end) - size, int(end)) for (name, size), end in zip(sizes.items(), ends, strict=True)}


class Writer:
    """Symbols of one model and the functions written with them."""

    def __init__(self, model: Model) -> None:
        self.layout = layout = Layout.from_robot(model.robot)
        self.names = (*model.values, *((CLOCK, BEGAN) if model.timed else ()))
        self.theta = ca.SX.sym("theta", len(self.names))
        self.value = dict(zip(self.names, ca.vertsplit(self.theta), strict=True))
        mount = model.robot.mount
        self.rotation, self.position = mount.rotation, np.array(mount.base_position_m)
        gravity = mount.rotation.T @ np.array(mount.gravity_m_per_s2)

        def active(kind: Effect, prefix: str, detail: str | None) -> tuple[Effect, dict[str, ca.SX], Context]:
            own = {p.name: self.value[f"{prefix}.{p.name}"] for p in kind.parameters_of(layout)}
            own |= {name: self.value[name] for name in (CLOCK, BEGAN) if kind.timed}
            index = None if detail is None else layout.details(kind.detail).index(detail)
            return kind, own, Context(layout, index, self.rotation, self.position, gravity)

        self.effects = [active(kind, kind.name, None) for kind in STANDARD]
        for effect in sorted(model.effects, key=lambda each: not find_effect(each.name).of_device):
            self.effects.append(active(find_effect(effect.name), effect.label, effect.detail))

        self.numbered = any(kind.has(hook) for kind, _, _ in self.effects for hook in POINT_HOOKS)
        self.sprung = any(kind.has("tendon_energy") for kind, _, _ in self.effects)
        self.strung = self.sprung or any(kind.feels_tension for kind, _, _ in self.effects)
        self.rows = property_rows(layout, self.strung, self.numbered)

    def rest_ring(self) -> ca.SX:
        """Nodes of a level at rest about its centre, (3, actuators)."""
        angles = np.array(self.layout.angles)
        return self.value["r"] * ca.DM(np.stack([np.cos(angles), np.sin(angles), 0 * angles]))

    def actuators(self, values: ca.SX) -> ca.SX:
        """Values of all actuators, module-major, as (modules, actuators)."""
        return ca.reshape(values, self.layout.actuators, self.layout.modules).T

    def input_map(self) -> tuple[ca.SX, ca.SX]:
        """u and the effective actuation a, both [pressures, tensions]."""
        layout = self.layout
        u = ca.SX.sym("u", layout.inputs)
        half = layout.inputs // 2
        pressure, tension = self.actuators(u[:half]), self.actuators(u[half:])
        for kind, own, context in self.effects:
            pressure, tension = kind.inputs(pressure, tension, own, context)
            pressure = pressure + sum_blocks(kind.pressure_begun(ca.repmat(pressure, kind.branches, 1), own, context), kind.branches)
        return u, ca.vertcat(ca.vec(pressure.T), ca.vec(tension.T))

    def properties(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """a, external forces on the points in G (3 · points), P (rows, n) and level 0 (block)."""
        layout, value, n = self.layout, self.value, self.layout.levels
        a, external = ca.SX.sym("a", layout.inputs), ca.SX.sym("external", 3, layout.points)
        half = layout.inputs // 2
        pressure, tension = self.actuators(a[:half]), self.actuators(a[half:])
        stiffness, damping, rest = zip(*(self._edge_at_rest(edge) for edge in layout.edges), strict=True)
        stiffness, damping, rest = (ca.repmat(ca.vertcat(*column), 1, n) for column in (stiffness, damping, rest))
        mass = value["m_d"] / (layout.actuators * layout.segments) * ca.SX.ones(n, 1)  # Eq. (2)
        network = Properties(stiffness, damping, rest, mass, pressure, tension)
        for kind, own, context in self.effects:
            kind.properties(network, own, context)
        force = ca.SX.zeros(3, n)
        for kind, own, context in self.effects:
            force += kind.loads(network, external, own, context)
        axial = value["A"] * network.pressure - network.tension  # F_a = p A - lambda, Eq. (3)
        axial, tension = (ca.horzcat(*(each[j // layout.segments, :].T for j in range(n))) for each in (axial, network.tension))
        parts = {"stiffness": network.stiffness, "damping": network.damping, "rest": network.rest}
        parts |= {
            "axial": axial,
            "tension": tension if self.strung else ca.SX(0, n),
            "load": force / layout.actuators,
            "mass": network.mass.T,
        }
        parts["number"] = ca.SX(ca.DM(np.arange(n, dtype=float)[None])) if self.numbered else ca.SX(0, n)
        return a, external, ca.vertcat(*(parts[name] for name in PROPERTY_ROWS)), ca.vec(self.rest_ring())

    def _edge_at_rest(self, edge: Edge) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Stiffness, damping and rest length of an edge of the nominal network, Eq. (4)."""
        value, segments = self.value, self.layout.segments
        ring, height = self.rest_ring(), self.value["L_0"] / segments
        across = ring[:, edge.b[1]] - ring[:, edge.a[1]] + (edge.b[0] - edge.a[0]) * height * ca.DM([0, 0, 1])
        gains = {VERTICAL: (1, 1), HORIZONTAL: (value["alpha_1"], value["beta_1"])}
        alpha, beta = gains.get(edge.kind, (value["alpha_2"], value["beta_2"]))
        return alpha * segments * value["K_a"], beta * segments * value["c_a"], norm(across)

    def segment(self) -> Segment:
        """The symbols of one segment."""
        block, rows = self.layout.block, max(s.stop for s in self.rows.values())
        return Segment(ca.SX.sym("lower", block), ca.SX.sym("upper", block), ca.SX.sym("P", rows))

    def rails(self, upper: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Rails of a guided robot: offset of a level's nodes from them, (block,), and their stiffness and damping, (block,) each.

        Rails are springs and dampers `RAIL` times as strong as a segment's muscles; without a guide all is 0.
        """
        layout, ring = self.layout, ca.vec(self.rest_ring())
        across = ca.repmat(ca.DM([1, 1, 0]), layout.actuators, 1) if layout.guided else ca.DM.zeros(layout.block)
        strength = self.value["K_a"] + SOFT, self.value["c_a"]
        stiffness, damping = (RAIL * layout.segments * each * across for each in strength)
        return across * (upper - ring), stiffness, damping

    def edge_law(self, index: int, edge: Edge, column: ca.SX) -> Callable[[ca.SX], tuple[ca.SX, ca.SX, ca.SX]]:
        """Energy of an edge and its first two derivatives, as a function of the edge's length."""
        length = ca.SX.sym("length")
        stiffness, _, rest = (column[self.rows[name]][index] for name in PROPERTY_ROWS[:3])
        energy = stiffness / 2 * (length - rest) ** 2
        if edge.kind == VERTICAL:
            energy -= column[self.rows["axial"]][index] * length
            for kind, own, context in self.effects if self.sprung else ():
                energy += kind.tendon_energy(length, rest, column[self.rows["tension"]][index], own, context)
        for kind, own, context in self.effects:
            energy += kind.edge_energy(edge, length, rest, own, context)
        slope = ca.gradient(energy, length)
        law = ca.Function("law", [length, column, self.theta], [energy, slope, ca.gradient(slope, length)])
        return lambda at: tuple(law.call([at, column, self.theta]))  # type: ignore[return-value]

    def drag_at_rest(self, edge: Edge, length: ca.SX) -> ca.SX:
        """Damping in N s/m that effects add to an edge at rest."""
        rate = ca.SX.sym("rate")
        drag = sum((kind.edge_drag(edge, length, rate, own, context) for kind, own, context in self.effects), start=ca.SX(0))
        return ca.substitute(ca.gradient(drag, rate), rate, ca.SX(0))

    def point_forces(self, s: Segment, velocity: ca.SX | None = None) -> list[PointForce]:
        """Forces on the reference points of a segment that depend on their motion; at rest without velocities.

        Args:
            s: the segment's symbols.
            velocity: of its nodes, (2 · block,).
        """
        layout, found = self.layout, []
        for point in range(layout.points) if self.numbered else ():
            weights = layout.point_weights[point]
            segment = int(np.flatnonzero(weights)[-1]) - 1
            turned = [
                ca.repmat(ca.DM(self.rotation) * (weight / layout.actuators), 1, layout.actuators) for weight in weights[segment:][:2]
            ]
            way = ca.horzcat(*turned)  # from the segment's nodes to the point
            place, speed = ca.SX.sym("place", 3), ca.SX.sym("speed", 3)
            energy = sum((kind.point_energy(point, place, own, context) for kind, own, context in self.effects), start=ca.SX(0))
            drag = sum((kind.point_drag(point, place, speed, own, context) for kind, own, context in self.effects), start=ca.SX.zeros(3))
            here = ca.if_else(s.column[self.rows["number"]] == segment, 1.0, 0.0)
            force = ca.gradient(energy, place) - drag
            by_place, by_speed = ca.jacobian(force, place), ca.jacobian(force, speed)
            at = [
                ca.mtimes(way, ca.vertcat(s.lower, s.upper)) + ca.DM(self.position),
                ca.SX.zeros(3) if velocity is None else ca.mtimes(way, velocity),
            ]
            parts = ca.substitute([here * energy, here * force, here * by_place, here * by_speed], [place, speed], at)
            found.append(PointForce(way, *parts))
        return found

    def observe(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """All levels 0 … n (block · (n + 1)), reference points as measured in G (3 · points), actuator lengths (modules · actuators)."""
        x, places, lengths = self.places()
        for kind, own, context in self.effects:
            places = kind.outputs(places, own, context)
        return x, ca.vec(places), lengths

    def places(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """All levels 0 … n (block · (n + 1)), where the reference points are in G (3, points), actuator lengths (modules · actuators)."""
        layout = self.layout
        x = ca.SX.sym("x", layout.block * (layout.levels + 1))
        nodes = ca.reshape(x, 3, layout.actuators * (layout.levels + 1))
        level = [nodes[:, k * layout.actuators : (k + 1) * layout.actuators] for k in range(layout.levels + 1)]
        centres = ca.horzcat(*(ca.sum2(points) / layout.actuators for points in level))
        points = ca.mtimes(ca.DM(self.rotation), ca.mtimes(centres, ca.DM(layout.point_weights.T))) + ca.DM(self.position)
        spans = [[norm(level[k + 1][:, j] - level[k][:, j]) for k in range(layout.levels)] for j in range(layout.actuators)]
        lengths = [
            sum(spans[j][h * layout.segments : (h + 1) * layout.segments]) for h in range(layout.modules) for j in range(layout.actuators)
        ]
        return x, points, ca.vertcat(*lengths)


@dataclass(frozen=True)
class Segment:
    """Symbols of two neighbouring levels' nodes and of the properties between them."""

    lower: ca.SX
    upper: ca.SX
    column: ca.SX

    def ends(self, edge: Edge) -> tuple[ca.SX, ca.SX]:
        """Positions of an edge's two nodes."""
        levels = (self.lower, self.upper)
        return tuple(levels[level][3 * node : 3 * node + 3] for level, node in (edge.a, edge.b))  # type: ignore[return-value]


@dataclass(frozen=True)
class PointForce:
    """Resistance that a reference point's motion meets: energy, force that holds the point against it, and the force's derivatives.

    Attributes:
        way: from the segment's nodes to the point, (3, 2 · block).
        energy: in J.
        force: in G, (3,) in N.
        stiffness, damping: by place and by velocity, (3, 3) in N/m and N s/m.
    """

    way: ca.DM
    energy: ca.SX
    force: ca.SX
    stiffness: ca.SX
    damping: ca.SX


def sum_blocks(blocks: ca.SX, count: int) -> ca.SX:
    """Sum as many blocks of rows, which are below each other."""
    return sum(ca.vertsplit(blocks, blocks.shape[0] // count), start=ca.SX(0))


def norm(vector: ca.SX) -> ca.SX:
    """Euclidean length."""
    return ca.sqrt(ca.sumsqr(vector))


def spread(layout: Layout, edge: Edge, pair: ca.SX, matrix: ca.SX) -> None:
    """Add an edge's [[k, -k], [-k, k]] to a segment's matrix, in place.

    Args:
        layout: the network's geometry.
        edge: which one of the segment.
        pair: the block k, (3, 3).
        matrix: of the segment, (2 · block, 2 · block).
    """
    at = [level * layout.block + 3 * node for level, node in (edge.a, edge.b)]
    for i, row in enumerate(at):
        for j, column in enumerate(at):
            matrix[row : row + 3, column : column + 3] += pair if i == j else -pair


def pull_apart(layout: Layout, edge: Edge, vector: ca.SX, force: ca.SX) -> None:
    """Add an edge's gradient to a segment's force with opposite signs at its nodes, in place.

    Args:
        layout: the network's geometry.
        edge: which one of the segment.
        vector: gradient at the edge's second node, (3,) in N.
        force: of the segment, (2 · block,) in N.
    """
    for sign, (level, node) in ((-1, edge.a), (1, edge.b)):
        at = level * layout.block + 3 * node
        force[at : at + 3] += sign * vector


def function(name: str, arguments: list[ca.SX], results: list[ca.SX]) -> ca.Function:
    """A dense CasADi function with common subexpressions written once."""
    return ca.Function(name, arguments, ca.cse([ca.densify(result) for result in results]))

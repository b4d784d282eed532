"""The mass-damper-spring network written symbolically, one segment at a time.

The network is a chain of segments between levels 0 (fixed) … n, so everything the solvers need is a sum over segments of
one small function of two neighbouring levels and the segment's properties. That makes the stiffness matrix block
tridiagonal by construction, the generated code independent of the number of segments, and effects local.

Order of what happens to the inputs u (SPEC section 1):  u --input map--> a = [effective pressures, effective tensions]
--properties--> P (one column a segment) --segment--> energy, force, stiffness.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from tepm_opt.models.effects import STANDARD, Context, Effect, Properties, find_effect
from tepm_opt.models.layout import HORIZONTAL, VERTICAL, Edge, Layout
from tepm_opt.models.model import Model

PROPERTY_ROWS = ("stiffness", "damping", "rest", "axial", "load", "mass")
"""Rows of P: of every edge (three times), axial force of every vertical edge, force on and mass of a node of the upper level."""

ROWS = 3
"""Number of weighted sums whose gradients the adjoint functions of a segment return at once."""


@dataclass(frozen=True)
class Network:
    """The CasADi functions of a model; arguments are dense column vectors (matrices column by column), SI, base frame.

    Attributes:
        layout: geometry.
        parameter_names: of theta, the parameter vector.
        functions: by name, see `write_network`.
        driven: rows of P that inputs or external forces change.
    """

    layout: Layout
    parameter_names: tuple[str, ...]
    functions: Mapping[str, ca.Function]
    driven: tuple[int, ...]

    @property
    def property_rows(self) -> dict[str, slice]:
        """Rows of P by name."""
        return _rows(self.layout)


def _rows(layout: Layout) -> dict[str, slice]:
    edges = len(layout.edges)
    sizes = dict(zip(PROPERTY_ROWS, (edges, edges, edges, layout.actuators, 3, 1), strict=True))
    ends = np.cumsum(list(sizes.values()))
    return {name: slice(int(end) - size, int(end)) for (name, size), end in zip(sizes.items(), ends, strict=True)}


class _Writer:
    """Symbols of one model and the functions written with them."""

    def __init__(self, model: Model) -> None:
        self.layout = layout = Layout.of(model.robot)
        self.rows = _rows(layout)
        self.names = tuple(model.values)
        self.theta = ca.SX.sym("theta", len(self.names))
        self.value = dict(zip(self.names, ca.vertsplit(self.theta), strict=True))
        mount = model.robot.mount
        self.rotation, self.position = mount.rotation, np.array(mount.base_position_m)
        gravity = mount.rotation.T @ np.array(mount.gravity_m_per_s2)
        details = {**{n: i for i, n in enumerate(layout.actuator_names)}, **{n: i for i, n in enumerate(layout.point_names)}}

        def active(kind: Effect, prefix: str, detail: str | None) -> tuple[Effect, dict[str, ca.SX], Context]:
            own = {p.name: self.value[f"{prefix}.{p.name}"] for p in kind.parameters}
            index = None if detail is None else details[detail]
            return kind, own, Context(layout, index, self.rotation, self.position, gravity)

        self.effects = [active(kind, kind.name, None) for kind in STANDARD]
        for effect in model.effects:
            prefix = f"{effect.name}[{effect.detail}]" if effect.detail else effect.name
            self.effects.append(active(find_effect(effect.name), prefix, effect.detail))

    def rest_ring(self) -> ca.SX:
        """Nodes of a level at rest about its centre, (3, actuators)."""
        angles = np.array(self.layout.angles)
        return self.value["r"] * ca.DM(np.stack([np.cos(angles), np.sin(angles), 0 * angles]))

    def input_map(self) -> tuple[ca.SX, ca.SX]:
        """u and the effective actuation a, both [pressures, tensions]."""
        layout = self.layout
        u = ca.SX.sym("u", layout.inputs)
        half = layout.inputs // 2
        pressure, tension = (ca.reshape(part, layout.actuators, layout.modules).T for part in (u[:half], u[half:]))
        for kind, own, context in self.effects:
            pressure, tension = kind.inputs(pressure, tension, own, context)
        return u, ca.vertcat(ca.vec(pressure.T), ca.vec(tension.T))

    def properties(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """a, external forces on the points in G (3 · points), P (rows, n) and level 0 (block)."""
        layout, value, n = self.layout, self.value, self.layout.levels
        a, external = ca.SX.sym("a", layout.inputs), ca.SX.sym("external", 3, layout.points)
        half = layout.inputs // 2
        pressure, tension = (ca.reshape(part, layout.actuators, layout.modules).T for part in (a[:half], a[half:]))
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
        axial = ca.horzcat(*(axial[j // layout.segments, :].T for j in range(n)))
        parts = {"stiffness": network.stiffness, "damping": network.damping, "rest": network.rest}
        parts |= {"axial": axial, "load": force / layout.actuators, "mass": network.mass.T}
        return a, external, ca.vertcat(*(parts[name] for name in PROPERTY_ROWS)), ca.vec(self.rest_ring())

    def _edge_at_rest(self, edge: Edge) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Stiffness, damping and rest length of an edge of the nominal network, Eq. (4)."""
        value, segments = self.value, self.layout.segments
        ring, height = self.rest_ring(), self.value["L_0"] / segments
        across = ring[:, edge.b[1]] - ring[:, edge.a[1]] + (edge.b[0] - edge.a[0]) * height * ca.DM([0, 0, 1])
        gains = {VERTICAL: (1, 1), HORIZONTAL: (value["alpha_1"], value["beta_1"])}
        alpha, beta = gains.get(edge.kind, (value["alpha_2"], value["beta_2"]))
        return alpha * segments * value["K_a"], beta * segments * value["c_a"], _norm(across)

    def segment(self) -> _Segment:
        """The symbols of one segment."""
        block, rows = self.layout.block, max(s.stop for s in self.rows.values())
        return _Segment(ca.SX.sym("lower", block), ca.SX.sym("upper", block), ca.SX.sym("P", rows))

    def edge_law(self, index: int, edge: Edge, column: ca.SX) -> Callable[[ca.SX], tuple[ca.SX, ca.SX, ca.SX]]:
        """Energy of an edge and its first two derivatives, as a function of the edge's length."""
        length = ca.SX.sym("length")
        stiffness, _, rest = (column[self.rows[name]][index] for name in PROPERTY_ROWS[:3])
        energy = stiffness / 2 * (length - rest) ** 2
        if edge.kind == VERTICAL:
            energy -= column[self.rows["axial"]][index] * length
        for kind, own, context in self.effects:
            energy += kind.edge_energy(edge, length, rest, own, context)
        slope = ca.gradient(energy, length)
        law = ca.Function("law", [length, column, self.theta], [energy, slope, ca.gradient(slope, length)])
        return lambda at: tuple(law.call([at, column, self.theta]))  # type: ignore[return-value]

    def observe(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """All levels 0 … n (block · (n + 1)), reference points in G (3 · points), actuator lengths (modules · actuators)."""
        layout = self.layout
        x = ca.SX.sym("x", layout.block * (layout.levels + 1))
        nodes = ca.reshape(x, 3, layout.actuators * (layout.levels + 1))
        level = [nodes[:, k * layout.actuators : (k + 1) * layout.actuators] for k in range(layout.levels + 1)]
        centres = ca.horzcat(*(ca.sum2(points) / layout.actuators for points in level))
        points = ca.mtimes(ca.DM(self.rotation), ca.mtimes(centres, ca.DM(layout.point_weights.T))) + ca.DM(self.position)
        for kind, own, context in self.effects:
            points = kind.outputs(points, own, context)
        spans = [[_norm(level[k + 1][:, j] - level[k][:, j]) for k in range(layout.levels)] for j in range(layout.actuators)]
        lengths = [
            sum(spans[j][h * layout.segments : (h + 1) * layout.segments]) for h in range(layout.modules) for j in range(layout.actuators)
        ]
        return x, ca.vec(points), ca.vertcat(*lengths)


@dataclass(frozen=True)
class _Segment:
    lower: ca.SX
    upper: ca.SX
    column: ca.SX

    def ends(self, edge: Edge) -> tuple[ca.SX, ca.SX]:
        """Positions of an edge's two nodes."""
        levels = (self.lower, self.upper)
        return tuple(levels[level][3 * node : 3 * node + 3] for level, node in (edge.a, edge.b))  # type: ignore[return-value]


def _norm(vector: ca.SX) -> ca.SX:
    return ca.sqrt(ca.sumsqr(vector))


def _segment_functions(writer: _Writer, driven: list[int]) -> dict[str, ca.Function]:
    """Energy; energy, force and stiffness; convex stiffness; damping; edges; adjoints of the force; for one segment.

    In the convex stiffness compressed edges have no geometric stiffness, so that it is positive semidefinite. Matrices come as
    two block columns: (lower; upper) x lower and upper x upper.
    """
    layout, theta, s = writer.layout, writer.theta, writer.segment()
    block = layout.block
    energy = ca.SX(0)
    force = ca.SX.zeros(2 * block)
    stiffness, convex, damping = (ca.SX.zeros(2 * block, 2 * block) for _ in range(3))
    slopes, spans = [], []

    def spread(edge: Edge, pair: ca.SX, matrix: ca.SX) -> None:
        """Add [[k, -k], [-k, k]] to the matrix at the edge's nodes."""
        at = [level * block + 3 * node for level, node in (edge.a, edge.b)]
        for i, row in enumerate(at):
            for j, column in enumerate(at):
                matrix[row : row + 3, column : column + 3] += pair if i == j else -pair

    for index, edge in enumerate(layout.edges):
        a, b = s.ends(edge)
        length = _norm(b - a)
        along = (b - a) / length
        value, slope, curvature = writer.edge_law(index, edge, s.column)(length)
        energy += value
        slopes.append(slope)
        spans.append(length)
        for sign, (level, node) in ((-1, edge.a), (1, edge.b)):
            at = level * block + 3 * node
            force[at : at + 3] += sign * slope * along
        across = slope / length
        spread(edge, (curvature - across) * along @ along.T + across * ca.SX.eye(3), stiffness)
        across, curvature = ca.fmax(across, 0), ca.fmax(curvature, 0)
        spread(edge, (curvature - across) * along @ along.T + across * ca.SX.eye(3), convex)
        spread(edge, s.column[writer.rows["damping"]][index] * along @ along.T, damping)
    load = ca.repmat(s.column[writer.rows["load"]], layout.actuators, 1)
    energy -= ca.dot(load, s.upper)
    force[block:] -= load
    arguments = [s.lower, s.upper, s.column, theta]
    weights = ca.SX.sym("weights", 2 * block, ROWS)
    work = ca.mtimes(weights.T, force)
    by_column, by_theta = ca.jacobian(work, s.column).T, ca.jacobian(work, theta).T
    columns = {name: [matrix[:, :block], matrix[block:, block:]] for name, matrix in (("k", stiffness), ("k+", convex), ("c", damping))}
    return {
        "segment_energy": _function("segment_energy", arguments, [energy]),
        "segment_gradient": _function("segment_gradient", arguments, [force]),
        "segment_stiffness": _function("segment_stiffness", arguments, [energy, force, *columns["k"]]),
        "segment_convex": _function("segment_convex", arguments, [energy, force, *columns["k+"]]),
        "segment_damping": _function("segment_damping", arguments, columns["c"]),
        "segment_edges": _function("segment_edges", arguments, [ca.vertcat(*slopes), ca.vertcat(*spans)]),
        "segment_adjoint": _function("segment_adjoint", [*arguments, weights], [by_column[driven, :]]),
        "segment_theta_adjoint": _function("segment_theta_adjoint", [*arguments, weights], [by_column, by_theta]),
    }


def _function(name: str, arguments: list[ca.SX], results: list[ca.SX]) -> ca.Function:
    return ca.Function(name, arguments, ca.cse([ca.densify(result) for result in results]))


def _adjoint(function_name: str, arguments: list[ca.SX], wanted: list[ca.SX], results: list[ca.SX]) -> ca.Function:
    """Function of `arguments` and a weight for each of `results` that returns the gradients of the weighted sum."""
    weights = [ca.SX.sym(f"weight_{k}", *result.shape) for k, result in enumerate(results)]
    total = sum((ca.dot(ca.densify(result), weight) for result, weight in zip(results, weights, strict=True)), start=ca.SX(0))
    return _function(function_name, [*arguments, *weights], [ca.gradient(total, symbol) for symbol in wanted])


def write_network(model: Model) -> Network:
    """The CasADi functions of a model.

    Functions (arguments → results), all dense:
        input_map(u, theta) → a; properties(a, external, theta) → P, level 0; observe(x, theta) → points in G, lengths;
        segment_energy(lower, upper, P_j, theta) → energy; segment_gradient(…) → force;
        segment_stiffness(…), segment_convex(…) → energy, force, two block columns; segment_damping(…) → two block columns;
        segment_edges(…) → edge forces, lengths;
        input_map_adjoint, observe_adjoint: with a weight per result, gradients by their arguments;
        properties_adjoint(…, weights of P's driven rows) → by a, by external; properties_theta_adjoint(…, of all rows, of level 0);
        segment_adjoint(…, weights) → by P_j's driven rows; segment_theta_adjoint(…, weights) → by P_j, by theta, for ROWS weights.
    """
    writer = _Writer(model)
    theta = writer.theta
    u, a_of_u = writer.input_map()
    a, external, columns, level_0 = writer.properties()
    x, points, lengths = writer.observe()
    changes = ca.jacobian_sparsity(ca.vec(columns), ca.vertcat(a, ca.vec(external))).row()
    driven = sorted({row % columns.shape[0] for row in changes})
    functions = {
        "input_map": _function("input_map", [u, theta], [a_of_u]),
        "input_map_adjoint": _adjoint("input_map_adjoint", [u, theta], [u, theta], [a_of_u]),
        "properties": _function("properties", [a, external, theta], [columns, level_0]),
        "properties_adjoint": _adjoint("properties_adjoint", [a, external, theta], [a, external], [columns[driven, :]]),
        "properties_theta_adjoint": _adjoint("properties_theta_adjoint", [a, external, theta], [theta], [columns, level_0]),
        "observe": _function("observe", [x, theta], [points, lengths]),
        "observe_adjoint": _adjoint("observe_adjoint", [x, theta], [x, theta], [points, lengths]),
        **_segment_functions(writer, driven),
    }
    return Network(writer.layout, writer.names, functions, tuple(driven))

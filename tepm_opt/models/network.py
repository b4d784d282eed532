"""The mass-damper-spring network written symbolically, one segment at a time.

The network is a chain of segments between levels 0 (fixed) … n, so everything the solvers need is a sum over segments of
one small function of two neighbouring levels and the segment's properties. That makes the stiffness matrix block
tridiagonal by construction, the generated code independent of the number of segments, and effects local.

Order of what happens to the inputs u (SPEC section 1):  u --input map--> a = [effective pressures, effective tensions]
--properties--> P (one column a segment) --segment--> energy, force, stiffness.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from tepm_opt.models.layout import Layout
from tepm_opt.models.model import Model
from tepm_opt.models.symbols import Writer, function, norm, pull_apart, spread

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
        property_rows: rows of P by name.
        sprung: whether tendons have potentials of their own.
    """

    layout: Layout
    parameter_names: tuple[str, ...]
    functions: Mapping[str, ca.Function]
    driven: tuple[int, ...]
    property_rows: Mapping[str, slice]
    sprung: bool = False

    def __repr__(self) -> str:
        return f"Network({self.layout.levels} levels, {len(self.parameter_names)} parameters, {len(self.functions)} functions)"


def _segment_functions(writer: Writer, driven: list[int]) -> dict[str, ca.Function]:
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

    for index, edge in enumerate(layout.edges):
        a, b = s.ends(edge)
        length = norm(b - a)
        along = (b - a) / length
        value, slope, curvature = writer.edge_law(index, edge, s.column)(length)
        energy += value
        slopes.append(slope)
        spans.append(length)
        pull_apart(layout, edge, slope * along, force)
        across = slope / length
        spread(layout, edge, (curvature - across) * along @ along.T + across * ca.SX.eye(3), stiffness)
        across, curvature = ca.fmax(across, 0), ca.fmax(curvature, 0)
        spread(layout, edge, (curvature - across) * along @ along.T + across * ca.SX.eye(3), convex)
        drag = s.column[writer.rows["damping"]][index] + writer.drag_at_rest(edge, length)
        spread(layout, edge, drag * along @ along.T, damping)
    for met in writer.point_forces(s):
        energy += met.energy
        force += ca.mtimes(met.way.T, met.force)
        stiffness += met.way.T @ met.stiffness @ met.way
        convex += met.way.T @ ca.diag(ca.fmax(ca.diag(met.stiffness), 0)) @ met.way
        damping += met.way.T @ met.damping @ met.way
    if layout.guided:
        off, rail, rub = writer.rails(s.upper)
        energy += ca.dot(rail, off**2) / 2
        force[block:] += rail * off
        for matrix, strength in ((stiffness, rail), (convex, rail), (damping, rub)):
            matrix[block:, block:] += ca.diag(strength)
    load = ca.repmat(s.column[writer.rows["load"]], layout.actuators, 1)
    energy -= ca.dot(load, s.upper)
    force[block:] -= load
    arguments = [s.lower, s.upper, s.column, theta]
    weights = ca.SX.sym("weights", 2 * block, ROWS)
    work = ca.mtimes(weights.T, force)
    by_column, by_theta = ca.jacobian(work, s.column).T, ca.jacobian(work, theta).T
    columns = {name: [matrix[:, :block], matrix[block:, block:]] for name, matrix in (("k", stiffness), ("k+", convex), ("c", damping))}
    return {
        "segment_energy": function("segment_energy", arguments, [energy]),
        "segment_gradient": function("segment_gradient", arguments, [force]),
        "segment_stiffness": function("segment_stiffness", arguments, [energy, force, *columns["k"]]),
        "segment_convex": function("segment_convex", arguments, [energy, force, *columns["k+"]]),
        "segment_damping": function("segment_damping", arguments, columns["c"]),
        "segment_edges": function("segment_edges", arguments, [ca.vertcat(*slopes), ca.vertcat(*spans)]),
        "segment_adjoint": function("segment_adjoint", [*arguments, weights], [by_column[driven, :]]),
        "segment_theta_adjoint": function("segment_theta_adjoint", [*arguments, weights], [by_column, by_theta]),
    }


def _adjoint(function_name: str, arguments: list[ca.SX], wanted: list[ca.SX], results: list[ca.SX]) -> ca.Function:
    """Function of `arguments` and a weight for each of `results` that returns the gradients of the weighted sum."""
    weights = [ca.SX.sym(f"weight_{k}", *result.shape) for k, result in enumerate(results)]
    total = sum((ca.dot(ca.densify(result), weight) for result, weight in zip(results, weights, strict=True)), start=ca.SX(0))
    return function(function_name, [*arguments, *weights], [ca.gradient(total, symbol) for symbol in wanted])


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
    writer = Writer(model)
    theta = writer.theta
    u, a_of_u = writer.input_map()
    a, external, columns, level_0 = writer.properties()
    x, points, lengths = writer.observe()
    changes = ca.jacobian_sparsity(ca.vec(columns), ca.vertcat(a, ca.vec(external))).row()
    driven = sorted({row % columns.shape[0] for row in changes})
    functions = {
        "input_map": function("input_map", [u, theta], [a_of_u]),
        "input_map_adjoint": _adjoint("input_map_adjoint", [u, theta], [u, theta], [a_of_u]),
        "properties": function("properties", [a, external, theta], [columns, level_0]),
        "properties_adjoint": _adjoint("properties_adjoint", [a, external, theta], [a, external], [columns[driven, :]]),
        "properties_theta_adjoint": _adjoint("properties_theta_adjoint", [a, external, theta], [theta], [columns, level_0]),
        "observe": function("observe", [x, theta], [points, lengths]),
        "observe_adjoint": _adjoint("observe_adjoint", [x, theta], [x, theta], [points, lengths]),
        **_segment_functions(writer, driven),
    }
    return Network(writer.layout, writer.names, functions, tuple(driven), writer.rows, writer.sprung)

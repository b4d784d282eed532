"""The moving network written symbolically: damping, internal states of effects, inputs with memory (see `network` for rest).

The equations of motion are M dv/dt = -force(x, v, y, P), summed over segments like everything else. Internal states y are local:
those of the inputs follow from the inputs alone, those of an edge from its own motion, so both are eliminated on the spot and
the matrices stay block tridiagonal.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from tepm_opt.models.effect import CLOCK, Effect
from tepm_opt.models.layout import VERTICAL, Layout
from tepm_opt.models.memories import Memory
from tepm_opt.models.model import Model
from tepm_opt.models.symbols import Segment, Writer, function, norm, pull_apart, spread, sum_blocks

PRESSURE = 0  # of [pressures, tensions]


@dataclass(frozen=True)
class Dynamics:
    """The CasADi functions of a moving model; arguments are dense column vectors, SI, base frame.

    Attributes:
        layout: geometry.
        parameter_names: of theta.
        functions: by name, see `write_dynamics`.
        input_states, edge_states: numbers of internal states of the inputs, and of the edges of one segment.
    """

    layout: Layout
    parameter_names: tuple[str, ...]
    functions: Mapping[str, ca.Function]
    input_states: int
    edge_states: int

    def __repr__(self) -> str:
        return f"Dynamics({self.layout.levels} levels, {self.input_states} states of the inputs, {self.edge_states} of a segment's edges)"


def write_dynamics(model: Model) -> Dynamics:
    """The CasADi functions of a moving model.

    Functions (arguments → results); `…_by` are sparse Jacobians, results below each other by arguments beside each other:
        delay(theta) → times by which commands and known forces are late;  delay_by (theta);
        input_motion(u, du/dt, y, time, theta) → a, y: at the end of a time over which u arrived at its rate, with y as they were before;
        input_motion_by (u, du/dt, y, theta);
        properties(a, external, theta) → P, level 0;  properties_by (a, external, theta);
        segment_motion(lower, upper, their velocities, y, step, P_j, theta) → force, dy/dt;
        segment_tangent(…) → force, dy/dt, d force / d positions where the velocities are positions over `step`;
        segment_by (lower, upper, their velocities, y, P_j, theta);
        observe(x, theta) → points in G, lengths;  observe_by (x, theta).

    A segment's y are those at the start of an implicit stage of length `step` and act as they are at its end; step 0 takes them as
    they are.
    """
    writer = Writer(model)
    theta = writer.theta
    late = [(kind.delay(own), kind.delays_forces) for kind, own, _ in writer.effects]
    delay = ca.vertcat(*(sum((time for time, both in late if both or not forces), start=ca.SX(0)) for forces in (False, True)))
    a, external, columns, level_0 = writer.properties()
    x, points, lengths = writer.observe()
    inputs, moving = _input_dynamics(writer), _segment_dynamics(writer)
    functions = {
        "delay": function("delay", [theta], [delay]),
        "delay_by": _jacobian("delay_by", [theta], [delay], [theta]),
        "properties": function("properties", [a, external, theta], [columns, level_0]),
        "properties_by": _jacobian("properties_by", [a, external, theta], [columns, level_0], [a, external, theta]),
        "observe": function("observe", [x, theta], [points, lengths]),
        "observe_by": _observe_jacobian(writer),
        **inputs,
        **moving,
    }
    states = inputs["input_motion"].numel_in(2), moving["segment_motion"].numel_in(4)
    return Dynamics(writer.layout, writer.names, functions, *states)


FORWARD, BACKWARD = 0.0, 1.0  # CasADi's weights of the directions


def _jacobian(name: str, arguments: list[ca.SX], results: list[ca.SX], by: list[ca.SX]) -> ca.Function:
    """Sparse Jacobian of all results by some of the arguments."""
    stacked, columns = ca.vertcat(*(ca.vec(ca.densify(result)) for result in results)), ca.vertcat(*(ca.vec(symbol) for symbol in by))
    return ca.Function(name, arguments, ca.cse([_derivative(stacked, columns)]))


def _derivative(results: ca.SX, by: ca.SX) -> ca.SX:
    """Sparse derivative of a column by another, forward or backward, whichever takes fewer operations.

    CasADi chooses by the number of directions; a row here, of one actuator, depends on few of the operations: all that effects make
    of inputs is a quarter as long backward.
    """
    ways = ({"helper_options": {"ad_weight": weight, "ad_weight_sp": weight}} for weight in (FORWARD, BACKWARD))
    return min((ca.cse([ca.jacobian(results, by, way)])[0] for way in ways), key=_length)


def _length(expression: ca.SX) -> int:
    return int(ca.Function("length", ca.symvar(expression), [expression]).n_instructions())


def _observe_jacobian(writer: Writer) -> ca.Function:
    """`observe_by`: by the chain rule from the last effect on what is measured to the first, each of which changes points one by one."""
    x, places, lengths = writer.places()
    theta, count = writer.theta, places.numel()
    value, stages = places, []
    for kind, own, context in writer.effects:
        if kind.has("outputs"):
            here = ca.SX.sym("here", *places.shape)
            after = kind.outputs(here, own, context)
            by = _derivative(ca.vec(after), ca.vertcat(ca.vec(here), theta))
            after, by = ca.substitute([after, by], [here], [value])
            stages.append(by)
            value = after
    by_place, by_theta = ca.SX.eye(count), ca.SX(count, theta.numel())
    for by in reversed(stages):
        by_theta += ca.mtimes(by_place, by[:, count:])
        by_place = ca.mtimes(by_place, by[:, :count])
    of_points = ca.horzcat(ca.mtimes(by_place, ca.jacobian(ca.vec(places), x)), by_theta)
    of_lengths = ca.horzcat(ca.jacobian(lengths, x), ca.SX(lengths.numel(), theta.numel()))
    return ca.Function("observe_by", [x, theta], ca.cse([ca.vertcat(of_points, of_lengths)]))


def _input_dynamics(writer: Writer) -> dict[str, ca.Function]:
    half = writer.layout.inputs // 2
    u, rate, time = ca.SX.sym("u", 2 * half), ca.SX.sym("rate", 2 * half), ca.SX.sym("time")
    signal = [writer.actuators(u[:half]), writer.actuators(u[half:])]
    speed = [writer.actuators(rate[:half]), writer.actuators(rate[half:])]
    before: list[ca.SX] = []
    after: list[ca.SX] = []
    for kind, own, context in writer.effects:
        signal, speed = _map_inputs(kind, own, context, signal, speed)
        for which, remembers in enumerate((kind.pressure_memory, kind.tension_memory)):
            if not kind.has(remembers.__name__):
                continue
            count = kind.branches if which == PRESSURE else 1
            state = ca.SX.sym("y", count * half)
            y = ca.vertcat(*(writer.actuators(each) for each in ca.vertsplit(state, half)))
            at, passing = (ca.repmat(part[which], count, 1) for part in (signal, speed))
            begun, last = ca.SX.zeros(*y.shape), ca.SX.zeros(*y.shape)  # what y is counted from, now and when `time` began
            if which == PRESSURE and kind.has("pressure_begun"):
                begun, last = (kind.pressure_begun(there, own, context) for there in (at, at - time * passing))
            memory = remembers(at, passing, last + y, own, context)
            if memory is not None:
                reached = memory.advance(last + y, time)
                signal[which] = signal[which] + sum_blocks(reached, count)
                speed[which] = speed[which] + sum_blocks(reached - last - y, count) / time
                before.append(state)
                after.append(ca.vec((reached - begun).T))
    a = ca.vertcat(*(ca.vec(part.T) for part in signal))
    y, reached = ca.vertcat(ca.SX(0, 1), *before), ca.vertcat(ca.SX(0, 1), *after)
    arguments = [u, rate, y, time, writer.theta]
    return {
        "input_motion": function("input_motion", arguments, [a, reached]),
        "input_motion_by": _jacobian("input_motion_by", arguments, [a, reached], [u, rate, y, writer.theta]),
    }


def _map_inputs(
    kind: Effect, own: Mapping[str, ca.SX], context: object, signal: list[ca.SX], speed: list[ca.SX]
) -> tuple[list[ca.SX], list[ca.SX]]:
    """Signals and their rates behind an effect's input map."""
    if not kind.has("inputs"):
        return signal, speed
    symbols = [ca.SX.sym("s", *part.shape) for part in signal]
    now, passing = (own[CLOCK], 1) if kind.timed else (ca.SX.sym("now"), 0)
    mapped = ca.vertcat(*kind.inputs(*symbols, own, context))  # type: ignore[arg-type]
    at, along = (ca.vertcat(*(ca.vec(part) for part in parts)) for parts in (symbols, speed))
    change = ca.jtimes(ca.vec(mapped), ca.vertcat(at, now), ca.vertcat(along, passing))
    results = ca.substitute([mapped, ca.reshape(change, *mapped.shape)], [at], [ca.vertcat(*(ca.vec(part) for part in signal))])
    return ca.vertsplit(results[0], signal[0].shape[0]), ca.vertsplit(results[1], signal[0].shape[0])


def _segment_dynamics(writer: Writer) -> dict[str, ca.Function]:
    layout, s, step = writer.layout, writer.segment(), ca.SX.sym("step")
    block, edges = layout.block, len(layout.edges)
    velocity = [ca.SX.sym("v_lower", block), ca.SX.sym("v_upper", block)]
    force, tangent = ca.SX.zeros(2 * block), ca.SX.zeros(2 * block, 2 * block)
    before: list[ca.SX] = []
    changes: list[ca.SX] = []
    pulls: list[ca.SX] = []
    lengths: list[ca.SX] = []
    rates: list[ca.SX] = []
    # forces are written with pulls, and pulls with lengths and their rates, which are put in at the end: derivatives stay short
    pull, span, speed, trusted = (ca.SX.sym(name, edges) for name in ("pull", "span", "speed", "trusted"))
    for index, edge in enumerate(layout.edges):
        law, states, of_states = _edge_pull(writer, s, index, span[index], speed[index], step)
        stretched, dragged = ca.gradient(law, span[index]), ca.gradient(law, speed[index])
        a, b = s.ends(edge)
        v_a, v_b = (velocity[level][3 * node : 3 * node + 3] for level, node in (edge.a, edge.b))
        length = norm(b - a)
        inverse = 1 / length
        along = inverse * (b - a)
        rate = ca.dot(along, v_b - v_a)
        across = inverse * trusted[index]
        turning = inverse * ((v_b - v_a) - rate * along)  # how the rate changes with the edge's direction
        pull_apart(layout, edge, pull[index] * along, force)
        pair = along @ ((stretched + dragged / step - across) * along + dragged * turning).T + across * ca.SX.eye(3)
        spread(layout, edge, pair, tangent)
        before += states
        changes += of_states
        pulls.append(law)
        lengths.append(length)
        rates.append(rate)
    for met in writer.point_forces(s, ca.vertcat(*velocity)):
        force += ca.mtimes(met.way.T, met.force)
        tangent += met.way.T @ (met.stiffness + met.damping / step) @ met.way
    if layout.guided:
        off, rail, rub = writer.rails(s.upper)
        force[block:] += rail * off + rub * velocity[1]
        tangent[block:, block:] += ca.diag(rail + rub / step)
    force[block:] -= ca.repmat(s.column[writer.rows["load"]], layout.actuators, 1)
    y, of_y = ca.vertcat(ca.SX(0, 1), *before), ca.vertcat(ca.SX(0, 1), *changes)
    motion, seen = ca.vertcat(span, speed), ca.vertcat(*lengths, *rates)
    pulled = ca.vertcat(*pulls)
    laws = ca.vertcat(pulled, of_y)
    by = ca.vertcat(s.lower, s.upper, *velocity, y, s.column, writer.theta)
    of_laws = ca.jacobian(laws, motion) @ ca.jacobian(seen, by) + ca.jacobian(laws, by)
    of_force = ca.jacobian(force, pull) @ of_laws[:edges, :] + ca.jacobian(force, by)
    force, jacobian = ca.substitute([force, ca.vertcat(of_force, of_laws[edges:, :])], [pull], [pulled])
    force, jacobian, of_y, pulled, tangent = ca.substitute([force, jacobian, of_y, pulled, tangent], [motion], [seen])
    arguments = [s.lower, s.upper, *velocity, y, step, s.column, writer.theta]
    return {
        "segment_motion": function("segment_motion", arguments, [force, of_y, pulled]),
        "segment_tangent": function("segment_tangent", [*arguments, trusted], [force, of_y, pulled, tangent]),
        "segment_by": ca.Function("segment_by", arguments, ca.cse([jacobian])),
    }


def _edge_pull(writer: Writer, s: Segment, index: int, span: ca.SX, speed: ca.SX, step: ca.SX) -> tuple[ca.SX, list[ca.SX], list[ca.SX]]:
    """Force that pulls an edge's ends together, its internal states before a stage and their rates at its end."""
    edge = writer.layout.edges[index]
    own = {name: s.column[writer.rows[name]][index] for name in ("stiffness", "damping", "rest")}
    if edge.kind == VERTICAL:
        own |= {name: s.column[writer.rows[name]][index] for name in ("axial", "tension") if name == "axial" or writer.strung}
    pull = writer.edge_law(index, edge, s.column)(span)[1] + own["damping"] * speed
    states, rates = [], []
    for kind, parameters, context in writer.effects:
        found = kind.edge_memory(edge, span, speed, own, parameters, context)
        for memory in (found,) if isinstance(found, Memory) else found or ():
            states.append(ca.SX.sym("y"))
            rates.append(memory.rate(states[-1], step))
            pull += states[-1] + step * rates[-1]
        pull += kind.edge_drag(edge, span, speed, parameters, context)
    return pull, states, rates

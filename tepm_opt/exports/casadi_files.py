"""A model as CasADi's function files, which CasADi reads in Python, C++, MATLAB and Octave."""

from __future__ import annotations

from pathlib import Path

import casadi as ca

from tepm_opt.data.files import atomic_path, output_folder
from tepm_opt.models.compile import CompiledModel

TOLERANCE = 1e-10
"""N: residual to which `statics` is solved."""
MOST_ITERATIONS = 100


def export_casadi(model: CompiledModel, folder: str | Path) -> tuple[Path, ...]:
    """Write `casadi_functions` as <name>.casadi each; the files written.

    Args:
        model: with its effects and parameters, which become constants.
        folder: that is filled, and made where it is not there.

    Raises:
        InputError: the folder cannot be written to.
    """
    folder, written = output_folder(folder), []
    for name, function in casadi_functions(model).items():
        written.append(folder / f"{name}.casadi")
        with atomic_path(written[-1]) as path:
            function.save(str(path))
    return tuple(written)


def casadi_functions(model: CompiledModel) -> dict[str, ca.Function]:
    """A model's functions for CasADi, with named arguments and results, dense column vectors in SI.

    u and force are as everywhere; x are the free levels 1 … n in the base frame (n · block), x0 where to start from; a the effective
    actuation behind the effects' input maps, v velocities, y the edges' internal states, segment by segment.

        rest() → x;  actuation(u) → a, as it is in statics
        network(x, u, force) → energy, residual (its gradient by x), points, lengths
        statics(x0, u, force) → x, points, lengths: Newton's method; raises where it does not converge, and may find an unstable equilibrium
        gain(x0, u, force) → gain (3 · points, inputs): derivatives of all points
        motion(x, v, y, a, force) → acceleration, rate (of y), points, lengths
    """
    layout, theta = model.layout, ca.DM(model.theta)
    kernels = model.network.functions
    u, x, x0 = ca.MX.sym("u", layout.inputs), ca.MX.sym("x", layout.levels * layout.block), ca.MX.sym("x0", layout.levels * layout.block)
    force, a = ca.MX.sym("force", 3 * layout.points), ca.MX.sym("a", layout.inputs)
    actuation = ca.Function("actuation", [u], [kernels["input_map"](u, theta)], ["u"], ["a"])
    network = _network(model, actuation, x, u, force)
    residual = ca.Function("residual", [x, u, force], network.call([x, u, force])[1:2])
    solve = ca.rootfinder("solve", "newton", residual, {"abstol": TOLERANCE, "max_iter": MOST_ITERATIONS})
    found = solve(x0, u, force)
    seen = network.call([found, u, force])[2:]
    statics = ca.Function("statics", [x0, u, force], [found, *seen], ["x0", "u", "force"], ["x", "points", "lengths"])
    gain = ca.Function("gain", [x0, u, force], [ca.jacobian(seen[0], u)], ["x0", "u", "force"], ["gain"])
    rest = ca.Function("rest", [], [ca.DM(model.rest[1:].ravel())], [], ["x"])
    functions = (rest, actuation, network, statics, gain, _motion(model, x, a, force))
    return {function.name(): function for function in functions}


def _levels(x: ca.MX, level_0: ca.MX, block: int) -> tuple[ca.MX, ca.MX]:
    """Levels below and above every segment, (block, n) each."""
    levels = ca.horzcat(level_0, ca.reshape(x, block, -1))
    return levels[:, :-1], levels[:, 1:]


def _sum_at_levels(force: ca.MX, block: int) -> ca.MX:
    """Sum the forces on the segments' ends, (2 · block, n), at the free levels, (n · block,)."""
    below = ca.horzcat(force[:block, 1:], ca.MX.zeros(block, 1))
    return ca.vec(force[block:, :] + below)


def _network(model: CompiledModel, actuation: ca.Function, x: ca.MX, u: ca.MX, force: ca.MX) -> ca.Function:
    """Energy, residual and observations of the network at rest.

    Args:
        model: whose.
        actuation: its input map.
        x, u, force: symbols.
    """
    layout, kernels, theta = model.layout, model.network.functions, ca.DM(model.theta)
    P, level_0 = kernels["properties"].call([actuation(u), ca.reshape(force, 3, -1), theta])
    lower, upper = _levels(x, level_0, layout.block)
    arguments = lower, upper, P, ca.repmat(theta, 1, layout.levels)
    energy = ca.sum2(kernels["segment_energy"].map(layout.levels)(*arguments))
    residual = _sum_at_levels(kernels["segment_gradient"].map(layout.levels)(*arguments), layout.block)
    points, lengths = kernels["observe"].call([ca.vertcat(level_0, x), theta])
    results = [energy, residual, points, lengths]
    return ca.Function("network", [x, u, force], results, ["x", "u", "force"], ["energy", "residual", "points", "lengths"])


def _motion(model: CompiledModel, x: ca.MX, a: ca.MX, force: ca.MX) -> ca.Function:
    """Acceleration of the free levels, with the edges' internal states.

    Args:
        model: whose.
        x, a, force: symbols.
    """
    layout, stepper, theta = model.layout, model.reference_stepper, ca.DM(model.theta)
    kernels, states = stepper.dynamics.functions, stepper.dynamics.edge_states
    v, y = ca.MX.sym("v", x.numel()), ca.MX.sym("y", states * layout.levels)
    P, level_0 = kernels["properties"].call([a, ca.reshape(force, 3, -1), theta])
    lower, upper = _levels(x, level_0, layout.block)
    slower, faster = _levels(v, ca.MX.zeros(layout.block), layout.block)
    at = [lower, upper, slower, faster, ca.reshape(y, states, layout.levels), ca.MX.zeros(1, layout.levels), P]
    pulled, rates, _ = kernels["segment_motion"].map(layout.levels).call([*at, ca.repmat(theta, 1, layout.levels)])
    mass = ca.vec(ca.repmat(P[stepper.mass_row, :], layout.block, 1))
    acceleration = -_sum_at_levels(pulled, layout.block) / mass
    points, lengths = kernels["observe"].call([ca.vertcat(level_0, x), theta])
    names = ["x", "v", "y", "a", "force"], ["acceleration", "rate", "points", "lengths"]
    return ca.Function("motion", [x, v, y, a, force], [acceleration, ca.vec(rates), points, lengths], *names)

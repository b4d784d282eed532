"""Equal-curvature inverse kinematics: tip positions to axial forces to set points.

All modules have the same actuator lengths, L_1j = L_2j = … (same curvature, bending plane and length, IV.E), which makes the
configuration unique for three actuators; with more, the axial forces are those of minimum norm.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from tepm_opt.models.backends.interface import Pose, Status
from tepm_opt.models.compile import CompiledModel, finite_array
from tepm_opt.outcome import SOLVED, Ending, Outcome
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.kinematics.allocation import Allocation, allocate
from tepm_opt.solvers.kinematics.ik_problem import Balance, IkProblem, IkSettings
from tepm_opt.solvers.kinematics.nearest import nearest
from tepm_opt.solvers.mechanics.statics import Equilibrium, solve_actuated_statics
from tepm_opt.solvers.numerics.text import millimetres

FORCE_TOLERANCE = 1e-6  # N of change below which forces of redundant actuators are of minimum norm; set points are coarser
MAX_OVERSHOOT = 0.5  # parts of the forces' range by which the search may leave it; beyond, the nearest point within them is sought
MISSED = 1e-6  # N of axial force: set points that miss more do not hold the configuration
HOLDING_STEPS = 8
BINDING = 1e-6  # parts of its range within which a force is at its limit
DEFAULT = IkSettings()


@dataclass(frozen=True, eq=False)
class Configuration:
    """The configuration found for a target.

    Attributes:
        target: tip position in G, (3,) in m.
        equilibrium: of the axial forces, before any allocation or rounding.
        forces: axial forces F_a, (modules · actuators,) in N.
        allocation: set points.
        outcome: SOLVED, OUT_OF_REACH (this is the nearest reachable point) or FAILED; its message explains all but SOLVED.
        miss: distance of the tip from the target in m.
        limits: which limits bind, as "pressure_13 at its maximum".
        steps: Gauss-Newton steps taken.
    """

    target: np.ndarray
    equilibrium: Equilibrium
    forces: np.ndarray
    allocation: Allocation
    outcome: Outcome
    miss: float
    limits: tuple[str, ...] = ()
    steps: int = 0

    def __repr__(self) -> str:
        """The outcome and the main numbers, in a line."""
        limits = f", limits that bind: {len(self.limits)}" if self.limits else ""
        return f"Configuration({self.outcome.ending}, target {millimetres(self.target)}, miss {1e3 * self.miss:.3g} mm{limits})"

    @property
    def solved(self) -> bool:
        """Whether the tip is at the target."""
        return self.outcome.solved


@lru_cache(maxsize=16)
def _make_problem(model: CompiledModel, loads: bytes, mode: ActuationMode, mid_tension: float | None, settings: IkSettings) -> IkProblem:
    return IkProblem(model, np.frombuffer(loads).reshape(-1, 3), mode, mid_tension, settings)


def _problem(
    model: CompiledModel, loads: Sequence[float] | np.ndarray | None, mode: ActuationMode, mid_tension: float | None, settings: IkSettings
) -> IkProblem:
    """The problem of a model, kept for the next target."""
    return _make_problem(model, model.check_loads(loads).tobytes(), mode, mid_tension, settings)


def solve_ik(
    model: CompiledModel,
    target: Sequence[float] | np.ndarray,
    mode: ActuationMode = ActuationMode.HYBRID,
    loads: Sequence[float] | np.ndarray | None = None,
    start: Configuration | None = None,
    mid_tension: float | None = None,
    settings: IkSettings = DEFAULT,
) -> Configuration:
    """The equal-curvature configuration whose tip is at the target, and the set points that hold it.

    Newton on levels and forces together, in one call of the backend, then Gauss-Newton on the axial forces with exact derivatives
    of the statics; where the result needs forces beyond the mode's limits, the nearest point within them (`nearest`).

    Args:
        model: compiled model.
        target: tip position in G, (3,) in m.
        mode: how the forces are made.
        loads: known forces on the reference points (points, 3) or the tip (3,) in G, N.
        start: a configuration nearby, such as the trajectory's previous one.
        mid_tension: see `allocate`.
        settings: tolerances.

    Raises:
        InputError: target or loads of a wrong shape or not finite.
    """
    problem, target = _problem(model, loads, mode, mid_tension, settings), finite_array(target, (3,), "target")
    near = None if start is None else start.equilibrium
    found, status = _quick(problem, target[None], near)
    return _find_holding_inputs(problem, found[0] if found else _thorough(problem, target, near, status))


def each_configuration(
    model: CompiledModel,
    targets: np.ndarray,
    mode: ActuationMode = ActuationMode.HYBRID,
    loads: Sequence[float] | np.ndarray | None = None,
    mid_tension: float | None = None,
    settings: IkSettings = DEFAULT,
) -> Iterator[Configuration]:
    """`solve_ik` for many targets, one after the other, each started from the last one solved.

    Args:
        targets: tip positions in G, (points, 3) in m.
        model, mode, loads, mid_tension, settings: see `solve_ik`.

    Raises:
        InputError: targets or loads of a wrong shape or not finite.
    """
    problem, last = _problem(model, loads, mode, mid_tension, settings), None
    left = finite_array(targets, (len(targets), 3), "targets")
    while len(left):
        found, status = _quick(problem, left, last)
        if status != Status.SOLVED:
            found.append(_thorough(problem, left[len(found)], found[-1].equilibrium if found else last, status))
        last = next((each.equilibrium for each in reversed(found) if each.solved), last)
        yield from (_find_holding_inputs(problem, each) for each in found)
        left = left[len(found) :]


def solve_trajectory(
    model: CompiledModel,
    targets: np.ndarray,
    mode: ActuationMode = ActuationMode.HYBRID,
    loads: Sequence[float] | np.ndarray | None = None,
    mid_tension: float | None = None,
    settings: IkSettings = DEFAULT,
) -> list[Configuration]:
    """All configurations along a trajectory, solved or not.

    Args:
        model, targets, mode, loads, mid_tension, settings: see `each_configuration`.
    """
    return list(each_configuration(model, targets, mode, loads, mid_tension, settings))


def _quick(problem: IkProblem, targets: np.ndarray, start: Equilibrium | None) -> tuple[list[Configuration], Status]:
    """Configurations that one call of the backend finds at the first of the targets, and the status that ended it."""
    if problem.redundant:
        return [], Status.EXHAUSTED
    x, actuation = (problem.model.rest, problem.actuation(problem.seed(targets[0]))) if start is None else (start.x, start.inputs)
    poses, status = problem.model.statics.configurations(problem.shared, targets, x, actuation, start is None)
    return [_make_configuration(problem, target, pose) for target, pose in zip(targets, poses, strict=False)], status


def _make_configuration(problem: IkProblem, target: np.ndarray, pose: Pose) -> Configuration:
    model, layout = problem.model, problem.model.layout
    split = 3 * layout.points
    points, lengths = pose.observed[:split].reshape(-1, 3), pose.observed[split:].reshape(layout.modules, layout.actuators)
    at = Equilibrium(model, pose.actuation, problem.loads, pose.x, points, lengths, SOLVED, 0, pose.residual, 1.0, True)
    forces, made = problem.area * pose.actuation[: problem.half], Allocation(pose.inputs, pose.rounded, pose.missed)
    limits = _limits(problem, forces) if pose.room <= BINDING else ()
    return Configuration(target, at, forces, made, _assess_allocation(made), math.dist(points[-1], target), limits, int(pose.steps))


def _find_holding_inputs(problem: IkProblem, found: Configuration) -> Configuration:
    """Find set points that hold a configuration where what tendons carry depends on the configuration, too.

    Newton on the forces asked of the set points, until these lead to the tip and length differences of the configuration.
    """
    model, at = problem.model, found.equilibrium
    if not model.network.sprung:
        return found
    for _ in range(HOLDING_STEPS):
        effective = model.statics.actuation(found.allocation.inputs, model.theta)
        held = solve_actuated_statics(model, effective, problem.loads, at)
        off = problem.errors(held, at.tip)
        if not held.solved or np.abs(off).max() < problem.settings.tolerance:
            break
        try:
            forces = found.forces - np.linalg.lstsq(problem.jacobian(held), off, rcond=None)[0]
        except np.linalg.LinAlgError:
            break
        made = allocate(model, forces, problem.mode, problem.mid_tension)
        found = replace(found, forces=forces, allocation=made, outcome=_assess_allocation(made) if found.solved else found.outcome)
    return found


def _assess_allocation(made: Allocation) -> Outcome:
    """Outcome of a configuration that these set points shall hold."""
    if made.error <= MISSED:
        return SOLVED
    message = f"the set points miss an axial force by {made.error:.3g} N: no inputs within the limits make it"
    return Outcome(Ending.OUT_OF_REACH, message)


def _thorough(problem: IkProblem, target: np.ndarray, start: Equilibrium | None, status: Status) -> Configuration:
    """A target that the quick way has left with this status: from another start, or the nearest point within the limits."""
    if start is not None and status != Status.BEYOND:
        again, status = _quick(problem, target[None], None)
        if again:
            return again[0]
    found = _least_forces(problem, target, start) if problem.redundant else None
    outcome = SOLVED
    if found is None:
        found, outcome = nearest(problem, target)
        exact = _quick(problem, target[None], found.equilibrium)[0] if outcome.solved else ()
        if exact:
            return replace(exact[0], steps=exact[0].steps + found.steps)
    made = allocate(problem.model, found.forces, problem.mode, problem.mid_tension)
    limits, miss = _limits(problem, found.forces), math.dist(found.equilibrium.tip, target)
    if outcome.solved:
        outcome = _assess_allocation(made)
    elif not outcome.message:
        binding = ", ".join(limits) or "no limit binding (the stable branch may end there)"
        outcome = replace(outcome, message=f"out of reach: the nearest point misses by {1e3 * miss:.2f} mm, with {binding}")
    return Configuration(target, found.equilibrium, found.forces, made, outcome, miss, limits, found.steps)


def _least_forces(problem: IkProblem, target: np.ndarray, start: Equilibrium | None) -> Balance | None:
    """The configuration of redundant actuators with the smallest forces where that is within the limits."""
    if start is not None and (found := _gauss_newton(problem, target, problem.area * start.inputs[: problem.half], start)):
        return found if problem.is_within_limits(found.forces) else None
    found = _gauss_newton(problem, target, problem.seed(target), None)
    return found if found and problem.is_within_limits(found.forces) else None


def _gauss_newton(problem: IkProblem, target: np.ndarray, forces: np.ndarray, start: Equilibrium | None) -> Balance | None:
    """Minimum-norm Gauss-Newton from given forces; None where it leaves the limits far behind or does not converge."""
    at, settings = problem.solve_equilibrium(forces, start), problem.settings
    if not at.solved:
        return None
    errors, change = problem.errors(at, target), np.inf
    for step in range(settings.max_iterations):
        if np.abs(errors).max() < settings.tolerance and change < FORCE_TOLERANCE:
            return Balance(forces, at, step)
        jacobian = problem.jacobian(at)
        full = np.linalg.lstsq(jacobian, jacobian @ forces - errors, rcond=1e-10)[0] - forces
        part = min(1.0, settings.max_step / np.abs(full).max())
        for _ in range(8):
            trial = problem.solve_equilibrium(forces + part * full, at)
            changed = problem.errors(trial, target)
            if trial.solved and np.linalg.norm(changed) < max(np.linalg.norm(errors), settings.tolerance):
                break
            part /= 2
        else:
            return None
        forces, at, errors, change = forces + part * full, trial, changed, part * np.abs(full).max()
        if (np.maximum(problem.low - forces, forces - problem.high) > MAX_OVERSHOOT * (problem.high - problem.low)).any():
            return None
    return None


def _limits(problem: IkProblem, forces: np.ndarray) -> tuple[str, ...]:
    """Limits that bind, in words."""
    close = BINDING * (problem.high - problem.low)
    lower = "pressure_{} at 0" if problem.mode is ActuationMode.PRESSURE else "tension_{} at its maximum"
    names = problem.model.layout.actuator_names
    found = [lower.format(name) for name, hit in zip(names, forces <= problem.low + close, strict=True) if hit]
    found += [f"pressure_{name} at its maximum" for name, hit in zip(names, forces >= problem.high - close, strict=True) if hit]
    return tuple(found)

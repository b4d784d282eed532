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
from tepm_opt.solvers.allocation import Allocation, allocate
from tepm_opt.solvers.choices import ActuationMode
from tepm_opt.solvers.ik_problem import Balance, IkProblem, IkSettings
from tepm_opt.solvers.nearest import nearest
from tepm_opt.solvers.statics import Equilibrium
from tepm_opt.solvers.text import millimetres

FORCE_TOLERANCE = 1e-6  # N of change below which forces of redundant actuators are of minimum norm; set points are coarser
HOMOTOPY_STEPS = 12  # from rest to a target that no first guess solves, each some centimetres
MAX_OVERSHOOT = 0.5  # parts of the forces' range by which the search may leave it; beyond, the nearest point within them is sought
MISSED = 1e-6  # N of axial force: set points that miss more do not hold the configuration
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
def _kept(model: CompiledModel, loads: bytes, mode: ActuationMode, mid_tension: float | None, settings: IkSettings) -> IkProblem:
    return IkProblem(model, np.frombuffer(loads).reshape(-1, 3), mode, mid_tension, settings)


def _problem(
    model: CompiledModel, loads: Sequence[float] | np.ndarray | None, mode: ActuationMode, mid_tension: float | None, settings: IkSettings
) -> IkProblem:
    """The problem of a model, kept for the next target."""
    return _kept(model, model.check_loads(loads).tobytes(), mode, mid_tension, settings)


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
    found, status = _quick(problem, target[None], start)
    return found[0] if found else _thorough(problem, target, start, status)


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
            found.append(_thorough(problem, left[len(found)], found[-1] if found else last, status))
        last = next((each for each in reversed(found) if each.solved), last)
        yield from found
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


def _quick(problem: IkProblem, targets: np.ndarray, start: Configuration | None) -> tuple[list[Configuration], Status]:
    """What one call of the backend finds at the first of the targets, and how what came after that ended."""
    if problem.redundant:
        return [], Status.EXHAUSTED
    if start is None:
        x, actuation = problem.model.rest, problem.actuation(problem.seed(targets[0]))
    else:
        x, actuation = start.equilibrium.x, start.equilibrium.inputs
    poses, status = problem.model.statics.configurations(problem.shared, targets, x, actuation, start is None)
    return [_posed(problem, target, pose) for target, pose in zip(targets, poses, strict=False)], status


def _posed(problem: IkProblem, target: np.ndarray, pose: Pose) -> Configuration:
    model, layout = problem.model, problem.model.layout
    split = 3 * layout.points
    points, lengths = pose.observed[:split].reshape(-1, 3), pose.observed[split:].reshape(layout.modules, layout.actuators)
    at = Equilibrium(model, pose.actuation, problem.loads, pose.x, points, lengths, SOLVED, 0, pose.residual, 1.0, True)
    forces, made = problem.area * pose.actuation[: problem.half], Allocation(pose.inputs, pose.rounded, pose.missed)
    limits = _limits(problem, forces) if pose.room <= BINDING else ()
    return Configuration(target, at, forces, made, _judged(made), math.dist(points[-1], target), limits, int(pose.steps))


def _judged(made: Allocation) -> Outcome:
    """How a configuration ended that these set points shall hold."""
    if made.error <= MISSED:
        return SOLVED
    message = f"the set points miss an axial force by {made.error:.3g} N: no inputs within the limits make it"
    return Outcome(Ending.OUT_OF_REACH, message)


def _thorough(problem: IkProblem, target: np.ndarray, start: Configuration | None, status: Status) -> Configuration:
    """A target that the quick way has left with this status: by all starts there are, or the nearest point."""
    free = None if status == Status.BEYOND else _free(problem, target, start)
    if free and problem.within(free.forces):
        found, outcome = free, SOLVED
    else:
        found, outcome = nearest(problem, target)
    made = allocate(problem.model, found.forces, problem.mode, problem.mid_tension)
    limits, miss = _limits(problem, found.forces), math.dist(found.equilibrium.tip, target)
    if outcome.solved:
        outcome = _judged(made)
    elif not outcome.message:
        binding = ", ".join(limits) or "no limit binding (the stable branch may end there)"
        outcome = replace(outcome, message=f"out of reach: the nearest point misses by {1e3 * miss:.2f} mm, with {binding}")
    return Configuration(target, found.equilibrium, found.forces, made, outcome, miss, limits, found.steps)


def _free(problem: IkProblem, target: np.ndarray, start: Configuration | None) -> Balance | None:
    """The configuration at the target without limits on the forces, or None."""
    if start is not None and (found := _gauss_newton(problem, target, start.forces, start.equilibrium)):
        return found
    if found := _gauss_newton(problem, target, problem.seed(target), None):
        return found
    at, forces, found = problem.at(np.zeros(problem.half), None), np.zeros(problem.half), None
    origin = at.tip
    for part in np.linspace(0, 1, HOMOTOPY_STEPS + 1)[1:]:
        found = _gauss_newton(problem, origin + part * (target - origin), forces, at)
        if found is None:
            return None
        forces, at = found.forces, found.equilibrium
    return found


def _gauss_newton(problem: IkProblem, target: np.ndarray, forces: np.ndarray, start: Equilibrium | None) -> Balance | None:
    """Minimum-norm Gauss-Newton from given forces; None where it leaves the limits far behind or does not converge."""
    at, settings = problem.at(forces, start), problem.settings
    if not at.solved:
        return None
    if not problem.redundant and (found := _together(problem, target, forces, at)):
        return found
    errors, change = problem.errors(at, target), np.inf
    for step in range(settings.max_iterations):
        if np.abs(errors).max() < settings.tolerance and (change < FORCE_TOLERANCE or not problem.redundant):
            return Balance(forces, at, step)
        jacobian = problem.jacobian(at)
        full = _minimum_norm(jacobian, jacobian @ forces - errors) - forces
        part = min(1.0, settings.max_step / np.abs(full).max())
        for _ in range(8):
            trial = problem.at(forces + part * full, at)
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


def _together(problem: IkProblem, target: np.ndarray, forces: np.ndarray, start: Equilibrium) -> Balance | None:
    """Newton on levels and forces together: quick, without safeguards; None where it does not converge to a stable equilibrium."""
    shared, settings = problem.shared, problem.settings
    status, x, pressures, steps = problem.model.statics.inverse(
        start.x, forces / problem.area, shared.external, shared.theta, shared.weights, np.append(target, np.zeros(problem.half - 3)),
        shared.max_step / problem.area, shared.tolerance, shared.force_tolerance, shared.max_iterations,
    )  # fmt: skip
    if status != Status.SOLVED:
        return None
    at = problem.at(pressures * problem.area, replace(start, x=x))
    if not at.solved or np.abs(problem.errors(at, target)).max() > settings.tolerance:
        return None
    return Balance(pressures * problem.area, at, steps)


def _minimum_norm(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution of least norm; the only one where the matrix is square and regular."""
    if matrix.shape[0] == matrix.shape[1]:
        try:
            return np.linalg.solve(matrix, right)
        except np.linalg.LinAlgError:
            pass
    return np.linalg.lstsq(matrix, right, rcond=1e-10)[0]


def _limits(problem: IkProblem, forces: np.ndarray) -> tuple[str, ...]:
    """Which limits bind, in words."""
    close = BINDING * (problem.high - problem.low)
    lower = "pressure_{} at 0" if problem.mode is ActuationMode.PRESSURE else "tension_{} at its maximum"
    names = problem.model.layout.actuator_names
    found = [lower.format(name) for name, hit in zip(names, forces <= problem.low + close, strict=True) if hit]
    found += [f"pressure_{name} at its maximum" for name, hit in zip(names, forces >= problem.high - close, strict=True) if hit]
    return tuple(found)

"""Equal-curvature inverse kinematics: tip positions to axial forces to set points.

All modules have the same actuator lengths, L_1j = L_2j = … (same curvature, bending plane and length, IV.E), which makes the
configuration unique for three actuators; with more, the axial forces are those of minimum norm.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.optimize import minimize

from tepm_opt.models.backends.interface import Status
from tepm_opt.models.compile import CompiledModel, finite_array
from tepm_opt.models.layout import Layout
from tepm_opt.outcome import SOLVED, Ending, Outcome
from tepm_opt.solvers.allocation import Allocation, allocate, force_range
from tepm_opt.solvers.choices import ActuationMode
from tepm_opt.solvers.constant_curvature import lengths_from_tip
from tepm_opt.solvers.statics import Equilibrium, equilibrium
from tepm_opt.solvers.text import millimetres

FORCE_TOLERANCE = 1e-6  # N of change below which forces of redundant actuators are of minimum norm; set points are coarser
HOMOTOPY_STEPS = 12  # from rest to a target that no first guess solves, each some centimetres
MAX_OVERSHOOT = 0.5  # parts of the forces' range by which the search may leave it; beyond, the nearest point within them is sought


@dataclass(frozen=True)
class IkSettings:
    """Settings of the inverse kinematics.

    Attributes:
        tolerance: largest error of tip and length differences, m.
        max_iterations: most Gauss-Newton steps from one start.
        max_step: largest change of an axial force in one step, N.
    """

    tolerance: float = 1e-9
    max_iterations: int = 30
    max_step: float = 8.0


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


_range = lru_cache(maxsize=16)(force_range)


@lru_cache(maxsize=16)
def _weights(layout: Layout) -> np.ndarray:
    """Rows that make tip and length differences of the observations (points in G, then lengths)."""
    half = layout.inputs // 2
    tip = np.zeros((3, 3 * layout.points + half))
    tip[:, 3 * layout.points - 3 : 3 * layout.points] = np.eye(3)
    differences = np.zeros(((layout.modules - 1) * layout.actuators, tip.shape[1]))
    lengths = differences[:, 3 * layout.points :]
    for row in range(len(lengths)):
        lengths[row, row + layout.actuators], lengths[row, row % layout.actuators] = 1.0, -1.0
    return np.concatenate([tip, differences])


class _IkProblem:
    """Tip error and length differences as functions of the axial forces, with derivatives."""

    def __init__(self, model: CompiledModel, loads: np.ndarray, mode: ActuationMode) -> None:
        self.model, self.loads = model, loads
        self.low, self.high = _range(model, mode)
        self.area, self.half = model.values["A"], model.layout.inputs // 2
        self.weights = _weights(model.layout)
        self.redundant = len(self.weights) < self.half

    def at(self, forces: np.ndarray, start: Equilibrium | None) -> Equilibrium:
        """Equilibrium of axial forces."""
        effective = np.concatenate([forces / self.area, np.zeros(self.half)])
        return equilibrium(self.model, effective, self.loads, start, mapped=True, explain=False)

    def errors(self, at: Equilibrium, target: np.ndarray) -> np.ndarray:
        """Tip error, then length differences to the first module, in m."""
        return np.concatenate([at.tip - target, (at.lengths[1:] - at.lengths[:1]).ravel()])

    def jacobian(self, at: Equilibrium) -> np.ndarray:
        """Derivatives of `errors` by the axial forces in m/N.

        Raises:
            LinAlgError: the equilibrium is not stable.
        """
        status, by_u, _, _ = self.model.statics.sensitivity(
            at.x, at.inputs, True, self.loads.ravel(), self.model.theta, self.weights, False
        )
        if status != Status.SOLVED:
            raise np.linalg.LinAlgError("stiffness not positive definite")
        return by_u[:, : self.half] / self.area


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

    Gauss-Newton on the axial forces with exact derivatives of the statics; where the result needs forces beyond the mode's limits,
    the nearest point within them (sequential quadratic programming, Kraft 1988, through SciPy).

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
    problem = _IkProblem(model, model.check_loads(loads), mode)
    return _solve(problem, finite_array(target, (3,), "target"), mode, start, mid_tension, settings)


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
    problem = _IkProblem(model, model.check_loads(loads), mode)
    last = None
    for target in finite_array(targets, (len(targets), 3), "targets"):
        found = _solve(problem, target, mode, last, mid_tension, settings)
        last = found if found.solved else last
        yield found


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


def _solve(
    problem: _IkProblem,
    target: np.ndarray,
    mode: ActuationMode,
    start: Configuration | None,
    mid_tension: float | None,
    settings: IkSettings,
) -> Configuration:
    free = _free(problem, target, start, settings)
    slack = 1e-9 * (problem.high - problem.low)
    within = free is not None and bool(((free.forces >= problem.low - slack) & (free.forces <= problem.high + slack)).all())
    found = free if free is not None and within else _nearest(problem, target, settings)
    allocation = allocate(problem.model, found.forces, mode, mid_tension)
    limits = _limits(problem, found.forces, mode)
    miss = float(np.linalg.norm(found.equilibrium.tip - target))
    found = replace(found, allocation=allocation, miss=miss, limits=limits)
    if not found.solved and not found.outcome.message:
        binding = ", ".join(limits) or "no limit binding (the stable branch may end there)"
        message = f"out of reach: the nearest point misses by {1e3 * miss:.2f} mm, with {binding}"
        return replace(found, outcome=replace(found.outcome, message=message))
    if allocation.error > 1e-6:
        message = f"the set points miss an axial force by {allocation.error:.3g} N: no inputs within the limits make it"
        return replace(found, outcome=Outcome(Ending.OUT_OF_REACH, message))
    return found


def _configuration(target: np.ndarray, at: Equilibrium, forces: np.ndarray, outcome: Outcome, steps: int = 0) -> Configuration:
    """A configuration whose set points are still to be allocated."""
    empty = Allocation(np.zeros(0), np.zeros(0), 0.0)
    return Configuration(target, at, forces, empty, outcome, 0.0, (), steps)


def _seed(problem: _IkProblem, target: np.ndarray) -> np.ndarray:
    """Axial forces by the constant-curvature lengths and the actuators' stiffness."""
    model = problem.model
    robot, value = model.robot, model.values
    local = robot.mount.rotation.T @ (target - np.array(robot.mount.base_position_m))
    try:
        lengths = lengths_from_tip(local, robot.modules, value["r"], robot.angles)
    except ValueError:
        return np.zeros(problem.half)
    return np.clip((lengths.ravel() - value["L_0"]) * value["K_a"], problem.low, problem.high)


def _free(problem: _IkProblem, target: np.ndarray, start: Configuration | None, settings: IkSettings) -> Configuration | None:
    """The configuration at the target without limits on the forces, or None."""
    if start is not None:
        quick = None if problem.redundant else _full_space_newton(problem, target, start.forces, start.equilibrium, settings)
        if found := quick or _gauss_newton(problem, target, start.forces, start.equilibrium, settings):
            return found
    if found := _gauss_newton(problem, target, _seed(problem, target), None, settings):
        return found
    at, forces, found = problem.at(np.zeros(problem.half), None), np.zeros(problem.half), None
    origin = at.tip
    for part in np.linspace(0, 1, HOMOTOPY_STEPS + 1)[1:]:
        found = _gauss_newton(problem, origin + part * (target - origin), forces, at, settings)
        if found is None:
            return None
        forces, at = found.forces, found.equilibrium
    return replace(found, target=target) if found else None


def _gauss_newton(
    problem: _IkProblem, target: np.ndarray, forces: np.ndarray, start: Equilibrium | None, settings: IkSettings
) -> Configuration | None:
    """Minimum-norm Gauss-Newton from given forces; None where it leaves the limits far behind or does not converge."""
    at = problem.at(forces, start)
    if not at.solved:
        return None
    if not problem.redundant and (found := _full_space_newton(problem, target, forces, at, settings)):
        return found
    errors, change = problem.errors(at, target), np.inf
    for step in range(settings.max_iterations):
        if np.abs(errors).max() < settings.tolerance and (change < FORCE_TOLERANCE or not problem.redundant):
            return _configuration(target, at, forces, SOLVED, step)
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


def _full_space_newton(
    problem: _IkProblem, target: np.ndarray, forces: np.ndarray, start: Equilibrium, settings: IkSettings
) -> Configuration | None:
    """Newton on levels and forces together: quick, without safeguards; None where it does not converge to a stable equilibrium."""
    model = problem.model
    targets = np.concatenate([target, np.zeros(problem.half - 3)])
    status, x, pressures, steps = model.statics.inverse(
        start.x, forces / problem.area, problem.loads.ravel(), model.theta, problem.weights, targets,
        settings.max_step / problem.area, settings.tolerance / 2, 1e-9, settings.max_iterations,
    )  # fmt: skip
    if status != Status.SOLVED:
        return None
    forces = pressures * problem.area
    at = problem.at(forces, replace(start, x=x))
    if not at.solved or np.abs(problem.errors(at, target)).max() > settings.tolerance:
        return None
    return _configuration(target, at, forces, SOLVED, steps)


def _minimum_norm(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution of least norm; the only one where the matrix is square and regular."""
    if matrix.shape[0] == matrix.shape[1]:
        try:
            return np.linalg.solve(matrix, right)
        except np.linalg.LinAlgError:
            pass
    return np.linalg.lstsq(matrix, right, rcond=1e-10)[0]


def _nearest(problem: _IkProblem, target: np.ndarray, settings: IkSettings) -> Configuration:
    """The configuration within the limits whose tip is nearest to the target.

    The distance has local minima (a target below the base seen by the straight robot), so the search starts from the middle of
    the forces and from bends towards the target and to its sides, and the best end counts.
    """
    robot = problem.model.robot
    local = robot.mount.rotation.T @ (target - np.array(robot.mount.base_position_m))
    middle, half_range = (problem.low + problem.high) / 2, (problem.high - problem.low) / 2
    towards = np.arctan2(local[1], local[0]) + np.array([0.0, 1.0, -1.0]) * np.pi / robot.actuators
    bends = [middle - 0.9 * half_range * np.tile(np.cos(robot.angles - angle), robot.modules) for angle in towards]
    ends = [_constrained(problem, target, forces, settings) for forces in (middle, *bends)]
    found = min((end for end in ends if end), key=lambda end: float(np.linalg.norm(end.equilibrium.tip - target)), default=None)
    if found and found.solved and problem.redundant:
        return _constrained(problem, target, found.forces, settings, least_norm=True) or found
    if found:
        return found
    message = "no stable equal-curvature configuration within the limits was found"
    if not problem.at(np.zeros(problem.half), None).solved:
        message += "; without inputs the robot is not stable either (it buckles under its weight or load)"
    return _configuration(target, problem.at(middle, None), middle, Outcome(Ending.FAILED, message))


def _constrained(
    problem: _IkProblem, target: np.ndarray, forces: np.ndarray, settings: IkSettings, least_norm: bool = False
) -> Configuration | None:
    """Within the limits and with equal curvature: the nearest tip, or, with `least_norm`, the smallest forces at the target."""
    scale, span = 1e-2, problem.high - problem.low  # errors in cm, forces in parts of their range
    held = 0 if least_norm else 3  # first of the errors that are constraints
    start = np.clip((forces - problem.low) / span, 0.0, 1.0)
    last = problem.at(problem.low + start * span, None)

    @lru_cache(maxsize=4)  # SLSQP asks for value and derivatives at the same point, one after the other
    def evaluate(part: bytes) -> tuple[Equilibrium, np.ndarray, np.ndarray]:
        nonlocal last
        last = problem.at(problem.low + np.frombuffer(part) * span, last)
        return last, problem.errors(last, target) / scale, problem.jacobian(last) * span / scale

    def errors(part: np.ndarray) -> np.ndarray:
        return evaluate(part.tobytes())[1]

    def jacobian(part: np.ndarray) -> np.ndarray:
        return evaluate(part.tobytes())[2]

    def objective(part: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = (problem.low / span + part, np.eye(len(part))) if least_norm else (errors(part)[:3], jacobian(part)[:3])
        return 0.5 * float(value @ value), slope.T @ value

    try:
        result = minimize(
            objective,
            start,
            jac=True,
            bounds=[(0.0, 1.0)] * len(forces),
            constraints={"type": "eq", "fun": lambda part: errors(part)[held:], "jac": lambda part: jacobian(part)[held:]},
            method="SLSQP",
            options={"maxiter": 200, "ftol": 1e-12},
        )
        part = np.clip(result.x, 0.0, 1.0)
        at, missed, _ = evaluate(part.tobytes())
    except np.linalg.LinAlgError:
        return None
    if not at.solved or scale * np.abs(missed[3:]).max(initial=0.0) > 1e-7:
        return None
    there = scale * np.abs(missed[:3]).max() < 100 * settings.tolerance
    return _configuration(target, at, problem.low + part * span, SOLVED if there else Outcome(Ending.OUT_OF_REACH), int(result.nit))


def _limits(problem: _IkProblem, forces: np.ndarray, mode: ActuationMode) -> tuple[str, ...]:
    close = 1e-6 * (problem.high - problem.low)
    lower = "pressure_{} at 0" if mode is ActuationMode.PRESSURE else "tension_{} at its maximum"
    names = problem.model.layout.actuator_names
    found = [lower.format(name) for name, hit in zip(names, forces <= problem.low + close, strict=True) if hit]
    found += [f"pressure_{name} at its maximum" for name, hit in zip(names, forces >= problem.high - close, strict=True) if hit]
    return tuple(found)

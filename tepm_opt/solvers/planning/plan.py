"""Plans: the fastest, or the gentlest, motion from rest to rest that the actuators can make, as set points.

A plan moves through configurations of equal curvature (`family`), chosen by a nonlinear program (`convex`). Its set points
come from the configurations themselves: exact equilibria, the forces of inertia and damping, pressures on the regulators' grid ahead of
their lag, and tensions that take what the pressures leave. Because the robot never leaves the planned motion, none of it sways at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.interpolate import make_interp_spline

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.models.compile import CompiledModel, finite_array
from tepm_opt.models.devices import Devices
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.progress import Progress, silent, track
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.kinematics.allocation import allocate
from tepm_opt.solvers.kinematics.ik import Configuration, each_configuration
from tepm_opt.solvers.linear.modal_model import modal_model
from tepm_opt.solvers.mechanics.statics import Equilibrium
from tepm_opt.solvers.planning.convex import solve
from tepm_opt.solvers.planning.family import Family, FamilyError, FamilyFit, axial, coordinates, make_family
from tepm_opt.solvers.planning.objective import Objective
from tepm_opt.solvers.planning.program import Limits, Obstacle, PlannedMotion, PlanTask, Route, distance
from tepm_opt.solvers.planning.result import MotionPlan
from tepm_opt.solvers.planning.setpoints import Friction, commands, residual_sway, tensions
from tepm_opt.solvers.planning.trajectories import Trajectory

EXACT = FamilyFit()
FASTEST, FOR_LOOPS = 1.2e-5, 3e-4  # s per N²/s, weights of the effort: within 1.3 times the linear arm's shortest time, and followed well
INTERVAL = 0.02  # m of a long way to each interval of the splines, up to twice their number
SMOOTHER = np.array([1.0, 10.0, 100.0])  # times the smoothness, until the full network is still enough
INSIDE = 0.02  # N by which the program may leave the limits of the forces, which set points on the grid do not
ROUTE_POINTS = 121  # inverse kinematics along a path, between which it is a spline


@dataclass(frozen=True)
class PlanSettings:
    """Settings of a plan.

    Attributes:
        devices: lags of the regulators and rate of the motors; as the model, or else its robot file, has them where absent.
        mid_tension: tension at rest at both ends, N; the middle of the range where absent.
        tension_reserve: what the program leaves to the regulators' grid, N.
        tension_rate_reserve: the same of the motors' rate, as part of it.
        min_stiffness: smallest stiffness eigenvalue, N/m; not looked at where absent.
        clearance: of the reference points from obstacles, m.
        frequency_uncertainty: part by which the sway's frequencies may differ from the model's.
        max_sway: sway that this may leave, m, which takes more than a period of the sway; only told, not bounded, where absent.
        friction_doubt: part of the tension that friction of the tendons may take beyond what the model has, either way: the plan leaves as
            much of the tensions' range and rate.
        max_spacing: longest time between set points, s.
        min_intervals: of the splines over time.
        max_iterations: most quadratic programs of a nonlinear one.
        effort_weight: weight of the effort in the fastest plan, s per N²/s; `FOR_LOOPS` leaves a controller room.
        max_residual_sway: sway in the full network above which the fastest plan is made anew, smoother, m.
        fit: of the family of configurations.
    """

    devices: Devices | None = None
    mid_tension: float | None = None
    tension_reserve: float = 0.15
    tension_rate_reserve: float = 0.2
    min_stiffness: float | None = None
    clearance: float = 0.002
    frequency_uncertainty: float = 0.05
    max_sway: float | None = None
    friction_doubt: float = 0.25
    max_spacing: float = 0.02
    min_intervals: int = 20
    max_iterations: int = 60
    effort_weight: float = FASTEST
    max_residual_sway: float = 8e-4
    fit: FamilyFit = EXACT


DEFAULT = PlanSettings()


def plan_move(
    model: CompiledModel, start: Sequence[float] | np.ndarray, end: Sequence[float] | np.ndarray, objective: Objective = Objective.TIME,
    duration: float | None = None, obstacles: Sequence[Obstacle] = (), settings: PlanSettings = DEFAULT,
    progress: Progress = silent,
) -> MotionPlan:  # fmt: skip
    """Plan from rest with the tip at `start` to rest with the tip at `end`, by any way.

    Args:
        model: compiled model.
        start, end: tips in G, (3,) in m.
        objective: fastest, or least effort.
        duration: in s, for the least effort.
        obstacles: that no reference point may enter.
        settings: limits and accuracy.
        progress: told what is being done.

    Raises:
        InputError: arguments that are not finite or do not fit together.
    """
    targets = np.array([finite_array(start, (3,), "start"), finite_array(end, (3,), "end")])
    if np.linalg.norm(targets[1] - targets[0]) < 1e-6:
        raise InputError(f"end {targets[1].tolist()}: is the start; valid: another place")
    return _plan(model, _Request(targets, None, objective, duration, tuple(obstacles)), settings, progress)


def plan_path(
    model: CompiledModel, trajectory: Trajectory, objective: Objective = Objective.TIME, duration: float | None = None,
    obstacles: Sequence[Obstacle] = (), settings: PlanSettings = DEFAULT, progress: Progress = silent,
) -> MotionPlan:  # fmt: skip
    """Plan along a trajectory's path from rest to rest; the speeds are the plan's own.

    The path is the quintic spline through the trajectory's points; its times do not count.

    Args:
        model: compiled model.
        trajectory: whose path to keep to.
        objective, duration, obstacles, settings, progress: see `plan_move`.

    Raises:
        InputError: fewer than 6 points, points that repeat, or as for `plan_move`.
    """
    points = np.vstack([trajectory.positions, trajectory.positions[:1]]) if trajectory.closed else trajectory.positions
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if len(points) < 6 or not np.isfinite(points).all() or chords.min() < 1e-6:
        raise InputError(f"trajectory: {len(points)} points; valid: at least 6 finite ones, each but a closing one other than the last")
    along = np.concatenate([[0.0], np.cumsum(chords)]) / chords.sum()
    if trajectory.closed:  # smooth where it closes
        wrapped = np.concatenate([along[-6:-1] - 1, along, along[1:6] + 1]), np.vstack([points[-6:-1], points, points[1:6]])
        curve = make_interp_spline(*wrapped, k=5)
    else:
        curve = make_interp_spline(along, points, k=5)
    parts = np.linspace(0.0, 1.0, ROUTE_POINTS)
    return _plan(model, _Request(curve(parts), parts, objective, duration, tuple(obstacles)), settings, progress)


@dataclass(frozen=True, eq=False)
class _Request:
    """Motion that is asked for: between two targets or, with their parts of the path, along many, (targets, 3); else see `plan_move`."""

    targets: np.ndarray
    parts: np.ndarray | None
    objective: Objective
    duration: float | None
    obstacles: tuple[Obstacle, ...]


def _check(model: CompiledModel, objective: Objective, duration: float | None, settings: PlanSettings) -> float:
    """The tension at rest.

    Raises:
        InputError: see `plan_move`.
    """
    if (duration is None) != (objective is Objective.TIME):
        raise InputError(f"duration: {duration}; valid: seconds for objective 'effort', none for 'time'")
    if duration is not None and not 0.05 <= duration <= 600:
        raise InputError(f"duration: {duration:g} s; valid: 0.05 … 600 s")
    if not 0 <= settings.tension_rate_reserve <= 0.9:
        raise InputError(f"tension_rate_reserve: {settings.tension_rate_reserve:g}; valid: 0 … 0.9 of the rate")
    if not 0 <= settings.frequency_uncertainty <= 0.5:
        raise InputError(f"frequency_uncertainty: {settings.frequency_uncertainty:g}; valid: 0 … 0.5")
    if settings.max_sway is not None and not 0 < settings.max_sway < np.inf:
        raise InputError(f"max_sway: {settings.max_sway:g} m; valid: more than 0")
    if not 0 <= settings.friction_doubt <= 0.9:
        raise InputError(f"friction_doubt: {settings.friction_doubt:g}; valid: 0 … 0.9 of the tension")
    if settings.min_stiffness is not None and not np.isfinite(settings.min_stiffness):
        raise InputError(f"min_stiffness: {settings.min_stiffness:g} N/m; valid: a number")
    highest = float(model.input_max[model.layout.inputs // 2 :].min())
    mid = highest / 2 if settings.mid_tension is None else settings.mid_tension
    if not 2 * settings.tension_reserve <= mid <= highest - 2 * settings.tension_reserve:
        low, high = 2 * settings.tension_reserve, highest - 2 * settings.tension_reserve
        raise InputError(f"mid_tension: {mid:g} N; valid: {low:g} … {high:g} N")
    return mid


@lru_cache(maxsize=4)
def _without_devices(model: CompiledModel) -> CompiledModel:
    """A model without regulators, of which set points are ahead, and friction of the tendons, which has no direction at rest.

    It is kept, as what else is kept of a model goes by the model.
    """
    theta = model.theta_without_devices
    return model if np.array_equal(theta, model.theta) else model.with_theta(theta)


def _plan(model: CompiledModel, asked: _Request, settings: PlanSettings, progress: Progress) -> MotionPlan:
    """Plan what is asked for."""
    targets, parts, duration, obstacles = asked.targets, asked.parts, asked.duration, asked.obstacles
    mid, devices = _check(model, asked.objective, duration, settings), settings.devices or Devices.from_model(model)
    layout, whole = model.layout, model
    model = _without_devices(model)

    def none(ending: Ending, message: str) -> MotionPlan:
        rows = SetPoints(np.zeros(0), np.zeros((0, layout.inputs)), np.zeros((0, 3)))
        points = np.zeros((0, layout.points, 3))
        forces, outcome = np.zeros((0, layout.inputs // 2)), Outcome(ending, message)
        return MotionPlan(whole, asked.objective, outcome, rows.time, points[:, 0], points, forces, rows)

    configurations = []
    each = each_configuration(model, targets, ActuationMode.HYBRID, None, mid)
    for found in track(each, progress, "inverse kinematics", len(targets)):
        if not found.solved:
            return none(Ending.OUT_OF_REACH, f"({', '.join(f'{v:g}' for v in found.target)}): {found.outcome.message}")
        configurations.append(found)
    ends = configurations[0], configurations[-1]
    for name, checked in (("start", ends[:1]), ("end", ends[1:])) if parts is None else (("path", configurations),):
        for found in checked:
            if why := _find_fault(found.equilibrium, obstacles, settings):
                return none(Ending.BLOCKED, f"{name}: {why}")
    progress("configurations about the task", 0, 0)
    lengths = coordinates(model, np.array([found.equilibrium.lengths[0] for found in configurations]))
    try:
        middle, bounded = configurations[len(configurations) // 2].equilibrium, settings.min_stiffness is not None
        family = make_family(model, lengths, middle, settings.fit, bounded)
    except FamilyError as error:
        return none(Ending.NO_PLAN, f"the configurations about the task are not all stable: {error}")
    y, area, half = family.normalise(lengths), model.values["A"], layout.inputs // 2
    if layout.actuators > 3:  # inverse kinematics takes the least forces, which are a little beside the family
        y = family.reach_targets(targets, y)
        try:
            ends = _in_family(family, ends[0], y[0], mid), _in_family(family, ends[1], y[-1], mid)
        except FamilyError as error:
            return none(Ending.NO_PLAN, f"at an end: {error}")
    air = area * ends[0].allocation.inputs[:half], area * ends[1].allocation.inputs[:half]
    sway = np.array([np.sqrt(modal_model(at, modes=2).stiffness) for at in (ends[0].equilibrium, family.middle, ends[1].equilibrium)])
    friction = Friction.from_model(whole, settings.friction_doubt)
    limits = _limits(model, ends, devices, friction, settings, (float(sway.min()), float(sway.max())))
    route = None if parts is None else Route(parts, y)
    way = float(np.linalg.norm(np.diff(targets, axis=0), axis=1).sum())
    intervals = int(np.clip(way / INTERVAL, settings.min_intervals, 2 * settings.min_intervals))
    task = PlanTask(
        family, (y[0], y[-1]), air, limits, obstacles, route, duration, intervals, settings.max_iterations, settings.effort_weight
    )
    progress("nonlinear program", 0, 0)
    iterations, seconds, plan = 0, 0.0, none(Ending.NO_PLAN, "")
    for weight in settings.effort_weight * SMOOTHER if duration is None else (settings.effort_weight,):
        motion, tries = _solve_from_guesses(replace(task, effort_weight=float(weight)))
        iterations, seconds = iterations + sum(one.iterations for one in tries), seconds + sum(one.seconds for one in tries)
        if not motion.solved:
            if plan.solved:
                break
            return none(Ending.NO_PLAN, _why(task, motion))
        progress("set points and simulation", 0, 0)
        try:
            plan = _build_plan(task, motion, ends, devices, settings, friction)
        except FamilyError as error:
            return none(Ending.NO_PLAN, f"on the way: {error}")
        if plan.solved and plan.residual_sway <= settings.max_residual_sway:
            break
    if not plan.solved:
        return none(plan.outcome.ending, plan.outcome.message)
    lowest, highest = float(sway.min()) / (2 * np.pi), float(sway.max()) / (2 * np.pi)
    return replace(plan, model=whole, sway_frequencies=(lowest, highest), iterations=iterations, seconds=seconds)


def _in_family(family: Family, found: Configuration, y: np.ndarray, mid: float) -> Configuration:
    """A configuration replaced by the family's at y, with its set points.

    Raises:
        FamilyError: there is none.
    """
    at = family.exact(y, found.equilibrium)
    return replace(found, equilibrium=at, forces=axial(at), allocation=allocate(family.model, axial(at), ActuationMode.HYBRID, mid))


def _solve_from_guesses(task: PlanTask) -> tuple[PlannedMotion, list[PlannedMotion]]:
    """The first motion found, from several guesses where there are obstacles to pass, and all tries."""
    tries = [solve(task)]
    for bulge in _bulges(*task.ends) if task.obstacles and task.route is None else ():
        if tries[-1].solved:
            break
        tries.append(solve(task, bulge))
    return tries[-1], tries


def _why(task: PlanTask, motion: PlannedMotion) -> str:
    """Words for a program without a solution."""
    ended = f"{motion.outcome.message} after {motion.iterations} quadratic programs"
    if task.duration is None:
        return f"no motion keeps the limits, margin and obstacles ({ended})"
    fastest = solve(replace(task, duration=None))
    hint = f"; the fastest plan takes {fastest.duration:.2f} s" if fastest.solved else ", nor does one of any duration"
    return f"no motion of {task.duration:g} s keeps the limits, margin and obstacles ({ended}){hint}"


def _find_fault(at: Equilibrium, obstacles: tuple[Obstacle, ...], settings: PlanSettings) -> str:
    """Fault of a configuration on the way: too little stability, a point in an obstacle; empty where there is none."""
    if settings.min_stiffness is not None and (found := at.smallest_eigenvalue) < settings.min_stiffness:
        return f"its smallest stiffness eigenvalue is {found:.4f} N/m; valid: at least the margin of {settings.min_stiffness:g} N/m"
    for number, obstacle in enumerate(obstacles, start=1):
        outside = distance(obstacle)
        for name, point in zip(at.model.layout.point_names, at.points, strict=True):
            if (away := float(outside(point))) < settings.clearance:
                where = f"{1e3 * abs(away):.1f} mm {'from' if away >= 0 else 'inside'} obstacle {number}"
                return f"{name} is {where}; valid: at least {1e3 * settings.clearance:g} mm away"
    return ""


def _limits(
    model: CompiledModel, ends: tuple[Configuration, Configuration], devices: Devices, friction: Friction, settings: PlanSettings,
    sway: tuple[float, float],
) -> Limits:  # fmt: skip
    """Limits of the program; those of the forces leave both ends inside, or it had no interior.

    Args:
        model: whose ranges.
        ends: of the plan.
        devices: lags and rate.
        friction: that tensions may have to make up for.
        settings: of the plan.
        sway: its lowest and highest frequency, 1/s.
    """
    half, doubt, highest = model.layout.inputs // 2, settings.frequency_uncertainty, model.input_max
    held = np.array([found.allocation.inputs[half:] for found in ends])
    frequencies = np.linspace(sway[0] * (1 - doubt), sway[1] * (1 + doubt), 3) if doubt and settings.max_sway is not None else ()
    most, part = float(highest[half:].min()), 1 + friction.share
    return Limits(
        air=(-INSIDE, float(model.values["A"] * highest[:half].min()) + INSIDE),
        tension=(
            float(min(max(settings.tension_reserve, friction.constant), held.min() - INSIDE)),
            float(max(min(most - settings.tension_reserve, (most - friction.constant) / part), held.max() + INSIDE)),
        ),
        max_tension_rate=devices.tension_rate * min(1 - settings.tension_rate_reserve, 1 / part),
        lags=(devices.filling, devices.exhausting),
        min_stiffness=settings.min_stiffness, clearance=settings.clearance, max_sway=settings.max_sway or np.inf,
        frequencies=tuple(float(value) for value in frequencies), frequency_uncertainty=doubt,
    )  # fmt: skip


def _bulges(start: np.ndarray, end: np.ndarray) -> list[np.ndarray]:
    """First guesses to four sides of the straight one."""
    across = np.linalg.svd((end - start)[None])[2][1:]
    return [sign * 0.5 * side for side in across for sign in (1.0, -1.0)]


def _build_plan(
    task: PlanTask, motion: PlannedMotion, ends: tuple[Configuration, Configuration], devices: Devices, settings: PlanSettings,
    friction: Friction,
) -> MotionPlan:  # fmt: skip
    """The plan at its rows: exact equilibria, forces and set points that make them.

    Args:
        task, motion: the program and what it found.
        ends: of the plan.
        devices: that make the forces.
        settings: of the plan.
        friction: that tensions may have to make up for.
    """
    family, model, layout = task.family, task.family.model, task.family.model.layout
    objective = Objective.TIME if task.duration is None else Objective.EFFORT
    half, area = layout.inputs // 2, model.values["A"]
    rows = int(np.ceil(motion.duration / settings.max_spacing - 1e-9)) + 1
    part = np.linspace(0.0, 1.0, rows)
    time, (y, v, a) = motion.duration * part, motion.lengths(part)
    at = [ends[0].equilibrium, *(family.exact(row) for row in y[1:-1]), ends[1].equilibrium]
    points, held = np.array([found.points for found in at]), np.array([axial(found) for found in at])
    errors = [
        float(np.abs(fitted(y) - exact.reshape(rows, -1)).max()) for fitted, exact in ((family.points, points), (family.forces, held))
    ]
    forces = held + family.compute_motion_forces(y, v, a)[0] - family.forces(y)
    wanted, rate = motion.air(part) / area, motion.air(part, 1) / area / motion.duration
    ahead = wanted + np.where(rate > 0, devices.filling, devices.exhausting) * rate
    effort = ((np.diff(area * ahead, axis=0) ** 2).sum() + (np.diff(area * wanted - forces, axis=0) ** 2).sum()) / time[1]
    inputs = np.zeros((rows, layout.inputs))
    inputs[:, :half], muscle = commands(model, ahead, wanted, time, devices)
    inputs[:, half:] = [tensions(model, pressures, needed) for pressures, needed in zip(muscle, forces, strict=True)]
    inputs[0], inputs[-1] = ends[0].allocation.inputs, ends[1].allocation.inputs
    message, wind = "", inputs[:, half:]
    wound = np.abs(np.diff(wind, axis=0)).max() / time[1]
    if wound > devices.tension_rate or wind.min() < -3 * INSIDE or (wind > model.input_max[half:] + 3 * INSIDE).any():
        message = (
            f"the tensions leave their limits ({wind.min():.2f} … {wind.max():.2f} N, up to {wound:.1f} N/s): "
            "the reserves of the settings are too small"
        )
    outcome = Outcome(Ending.NO_PLAN, message) if message else Outcome()
    setpoints = SetPoints(time, np.clip(inputs, 0.0, model.input_max), np.zeros((rows, 3)))
    muscle[-1] = wanted[-1]
    doubt, rest = settings.frequency_uncertainty, points[-1, -1]
    left, *doubted = (residual_sway(model, time * pace, muscle, wind, rest) for pace in ((1.0, 1 - doubt, 1 + doubt) if doubt else (1.0,)))
    return MotionPlan(
        model, objective, outcome, time, points[:, -1], points, forces, setpoints, min(found.smallest_eigenvalue for found in at),
        float(effort), residual_sway=left, doubted_sway=max([left, *doubted]), surrogate_error=(errors[0], errors[1]),
        friction_offset=friction.offset(ends[1].equilibrium, wind[-1]),
    )  # fmt: skip

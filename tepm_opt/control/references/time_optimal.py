"""Timing law along a path: the largest speed that actuators can follow.

    |F'(s)| s' ≤ what motors and regulators change the axial forces by in a second,      |s''|, κ s'² ≤ a = ω_1² δ

with F(s) the forces that hold the tip at s metres of the path, their ranges with the tension in its middle, κ the path's curvature, and ω_1
the arm's first natural frequency: an acceleration a bends it by δ. The fastest speed under both is found by integrating forth and back
(Bobrow, Dubowsky, Gibson, Time-optimal control of robotic manipulators along specified paths, IJRR 4, 1985).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from tepm_opt.errors import InputError
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.devices import Devices
from tepm_opt.progress import Progress, silent, track
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.kinematics.ik import IkSettings, each_configuration
from tepm_opt.solvers.linear.modal_model import modal_model
from tepm_opt.solvers.planning.trajectories import Trajectory

POINTS = 256  # of the path at which speeds are found
ROUNDED = 0.01  # of the path over which speeds are rounded
SLOWEST = 0.02  # of the largest speed, where an open path begins and ends
IK_DEFAULT = IkSettings()


@dataclass(frozen=True)
class PaceSettings:
    """Limits of the speed along a path whose progress is free.

    Attributes:
        reserve: part of what motors and regulators can do that is left to the feedback.
        sway: deflection in m by which the arm's inertia may bend it, δ.
        fastest: largest speed of the tip in m/s.
        slowest: part of the timing law's speed to which the progress slows down, and 1 is its own.
        small, large: errors of the tip over the horizon in m, up to which progress is at full speed and from which it is slowest.
        change: of that part in a second.
    """

    reserve: float = 0.5
    sway: float = 0.010
    fastest: float = 0.5
    slowest: float = 0.3
    small: float = 6e-3
    large: float = 20e-3
    change: float = 1.5


DEFAULT = PaceSettings()


def retime(
    model: CompiledModel,
    trajectory: Trajectory,
    settings: PaceSettings = DEFAULT,
    kinematics: IkSettings = IK_DEFAULT,
    progress: Progress = silent,
) -> Trajectory:
    """Retime a path to be as fast as actuators can follow; whatever time it had is forgotten.

    Args:
        model: the controller's.
        trajectory: at least two points that are not the same.
        settings: what is left to the feedback.
        kinematics: settings of the inverse kinematics.
        progress: told how many points are done.

    Raises:
        InputError: a path without length; a point out of reach.
    """
    positions = trajectory.positions if not trajectory.closed else np.vstack([trajectory.positions, trajectory.positions[:1]])
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    if len(positions) < 3 or not (steps > 0).all():
        raise InputError(f"path: {len(positions)} points, {int((steps == 0).sum())} of them twice; valid: at least 3, each another one")
    length = np.concatenate([[0.0], np.cumsum(steps)])
    curve = CubicSpline(length, positions, bc_type="periodic" if trajectory.closed else "not-a-knot")
    s = np.linspace(0.0, length[-1], POINTS + 1)
    each = track(each_configuration(model, curve(s), ActuationMode.HYBRID, settings=kinematics), progress, "speed along the path", len(s))
    forces, soft = [], np.inf
    for at, configuration in zip(s, each, strict=True):
        if not configuration.solved:
            raise InputError(f"path: at {at:.3f} m, {configuration.target.round(4).tolist()} m: {configuration.outcome.message}")
        forces.append(configuration.forces)
        if len(forces) % 32 == 1:
            soft = min(soft, float(modal_model(configuration.equilibrium).stiffness[0]))
    largest = soft * settings.sway
    speed = np.minimum(_by_forces(model, s, np.array(forces), settings, trajectory.closed), settings.fastest)
    bend = np.linalg.norm(np.cross(curve(s, 1), curve(s, 2)), axis=1)
    speed = np.minimum(speed, np.sqrt(largest / np.maximum(bend, 1e-9)))
    mode = "wrap" if trajectory.closed else "nearest"
    width = max(3, round(ROUNDED * POINTS))
    speed = gaussian_filter1d(minimum_filter1d(speed, 2 * width + 1, mode=mode), width / 2, mode=mode)
    if not trajectory.closed:
        speed[[0, -1]] = SLOWEST * speed.max()
    speed = _limit_acceleration(speed, largest, s[1], trajectory.closed)
    time = np.concatenate([[0.0], np.cumsum(2 * np.diff(s) / (speed[1:] + speed[:-1]))])
    last = POINTS if trajectory.closed else POINTS + 1
    return Trajectory(time[:last], curve(s[:last]), trajectory.closed)


def _by_forces(model: CompiledModel, s: np.ndarray, forces: np.ndarray, settings: PaceSettings, closed: bool) -> np.ndarray:
    """Speeds in m/s, (points,), at which forces (points, actuators) in N along s change as fast as motors and regulators can."""
    devices, half = Devices.from_model(model), forces.shape[1]
    area, limits = model.values["A"], model.robot.input_max
    middle = limits[half:] / 2
    pushed = np.clip(forces + middle, 0.0, area * limits[:half])
    filling = (area * limits[:half] - pushed) / devices.filling if devices.filling > 0 else np.full_like(forces, np.inf)
    exhausting = pushed / devices.exhausting if devices.exhausting > 0 else np.full_like(forces, np.inf)
    motors = devices.tension_rate * (limits[half:] > 0)
    spline = CubicSpline(s, np.vstack([forces[:-1], forces[:1]]) if closed else forces, bc_type="periodic" if closed else "not-a-knot")
    slope = spline(s, 1)
    rate = (1 - settings.reserve) * (motors + np.where(slope > 0, filling, exhausting))
    return (rate / np.maximum(np.abs(slope), 1e-9)).min(axis=1)


def _limit_acceleration(speed: np.ndarray, largest: float, step: float, closed: bool) -> np.ndarray:
    """Speeds limited to accelerations up to `largest` in m/s², forth and back; a closed path goes round twice."""
    squares = speed**2
    for _ in range(2 if closed else 1):
        for way in (1, -1):
            square = squares[::way]
            for k in range(1, len(square)):
                square[k] = min(square[k], square[k - 1] + 2 * largest * step)
            if closed:
                square[0] = square[-1] = min(square[0], square[-1])
    return np.sqrt(squares)

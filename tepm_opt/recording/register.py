"""A calibration recording of the base: slowly through set points, at rest at each, where the sensors' poses are averaged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Rig
from tepm_opt.hw.service.registration import Registration, register_base
from tepm_opt.models.channels import channels_of
from tepm_opt.models.compile import compile_model
from tepm_opt.models.robot import Mount, Robot
from tepm_opt.progress import Progress, silent
from tepm_opt.recording.drive import Driver
from tepm_opt.solvers.mechanics.statics import solve_statics

FEWEST = 5
"""Poses of a sensor that make a mean."""
PASSES, SAME_DEG = 12, 0.02
"""Most passes, and the angle between gravity in the model and as the base found has it at which they end."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Mean poses of the sensors at each row.

    Attributes:
        poses: means, (rows, points, 4, 4) in m; NaN where a sensor was lost.
        rested: whether the robot came to rest at each row.
    """

    poses: np.ndarray
    rested: tuple[bool, ...]

    def __repr__(self) -> str:
        return f"Recording({len(self.poses)} rows, at rest at {sum(self.rested)})"


def record_poses(rig: Rig, setpoints: SetPoints, robot: Robot, hold: float, progress: Progress = silent) -> Recording:
    """Rest at every row in turn for `hold` s, then go back to zero. The rig is stopped whatever happens.

    Args:
        rig: any whose samples have `transforms`; not yet entered.
        setpoints: their times do not count.
        robot: that they are for.
        hold: seconds in which poses are averaged.
        progress: told of every stage in s.

    Raises:
        InputError: the rig has another robot.
        RuntimeError: the rig failed.
    """
    poses, rested = [], []
    with rig:
        driver = Driver(rig, channels_of(robot), progress)
        driver.approach(setpoints.inputs[0])
        for number, inputs in enumerate(setpoints.inputs, start=1):
            driver.glide(inputs, f"to row {number} of {len(setpoints.inputs)}")
            rested.append(driver.settle())
            poses.append(mean_pose(_frames(driver, hold, number)))
        driver.finish()
    return Recording(np.array(poses), tuple(rested))


def _frames(driver: Driver, hold: float, row: int) -> np.ndarray:
    """All poses of some time, (samples, points, 4, 4)."""
    begin, taken = driver.now, []
    while driver.now - begin < hold:
        driver.apply(driver.inputs)
        sample = driver.read()
        driver.progress(f"measuring row {row}", driver.now - begin, hold)
        if sample.transforms is not None:
            taken.append(sample.transforms)
    return np.array(taken) if taken else np.full((1, len(driver.channels.points), 4, 4), np.nan)


def mean_pose(transforms: np.ndarray) -> np.ndarray:
    """Mean of poses (samples, points, 4, 4) in m, (points, 4, 4); NaN where a sensor gave too few."""
    mean = np.full(transforms.shape[1:], np.nan)
    for point in range(transforms.shape[1]):
        seen = transforms[np.isfinite(transforms[:, point]).all(axis=(1, 2)), point]
        if len(seen) >= FEWEST:
            mean[point] = np.eye(4)
            mean[point, :3, :3] = Rotation.from_matrix(seen[:, :3, :3]).mean().as_matrix()
            mean[point, :3, 3] = seen[:, :3, 3].mean(axis=0)
    return mean


def base_points(robot: Robot, setpoints: SetPoints, rotation: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """Compute the model's reference points in the base frame, (rows, points, 3) in m; NaN where it has no equilibrium.

    Args:
        robot: whose mount does not count.
        setpoints: with the tip force in G.
        rotation: from the base frame to G, (3, 3).
        gravity: in the base frame, (3,) in m/s².
    """
    mount = Mount(gravity_m_per_s2=_three(gravity), base_position_m=(0, 0, 0), base_rotation_deg=(0, 0, 0))
    model = compile_model(robot.model_copy(update={"mount": mount}), backend="python")
    rows, last = [], None
    for inputs, force in zip(setpoints.inputs, setpoints.tip_force @ rotation, strict=True):
        found = solve_statics(model, inputs, force, start=last)
        last = found if found.solved else last
        rows.append(found.points if found.solved else np.full(found.points.shape, np.nan))
    return np.array(rows)


def register(robot: Robot, setpoints: SetPoints, poses: np.ndarray, known_holders: bool = False) -> tuple[Registration, list[str]]:
    """The base's place, and the holders unless those of the robot file are taken as known; and what a person should know.

    Gravity bends the model's arm and depends on the base's tilt, which is sought. So this is done again and again with gravity half-way to
    where the last pass had it: the whole way would overshoot, because an arm bent too little looks like a base that is tilted.

    Args:
        robot: its mount is where this starts.
        setpoints: that were held.
        poses: of the sensors, (rows, points, 4, 4) in m; NaN where one was lost.
        known_holders: whether `holders_m` of the robot file stay.

    Raises:
        InputError: the rows do not tell where the base is; the message says what has to vary. Or the robot file names no tracker.
    """
    link = None if robot.hardware is None else robot.hardware.tracker
    if link is None:
        raise InputError(f"robot {robot.name}: the file has no [hardware.tracker], which says where poses come from")
    holders = np.array(link.holders_m or np.zeros((len(link.devices), 3))) if known_holders else None
    in_tracker, rotation, notes = np.array(robot.mount.gravity_m_per_s2), robot.mount.rotation, list[str]()
    gravity, number = in_tracker @ rotation, 0
    while True:
        number += 1
        points = base_points(robot, setpoints, rotation, gravity)
        found = register_base(poses, points, holders)
        rotation = Rotation.from_rotvec(np.deg2rad(found.rotation_deg)).as_matrix()
        off = _angle_deg(gravity, in_tracker @ rotation)
        if off < SAME_DEG or number >= PASSES:
            break
        gravity = _half_way(gravity, in_tracker @ rotation)
    if off >= SAME_DEG:
        notes.append(f"the base's tilt is still {off:.2f} degrees off the one that bends the model; more and other rows would help")
    if unsolved := int(np.isnan(points).any(axis=(1, 2)).sum()):
        notes.append(f"{unsolved} rows without an equilibrium of the model are left out")
    return found, notes + list(found.notes)


def _half_way(old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """The direction between two vectors of the same length; the new one where they are opposite."""
    middle = old + new
    length = np.linalg.norm(middle)
    return new if length < 0.1 * np.linalg.norm(new) else middle * np.linalg.norm(new) / length


def _three(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))

"""Options of tracking a trajectory: from rest, along it or point by point."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from tepm_opt.control.collision.elastic_band import detour
from tepm_opt.control.collision.geometry import Obstacles
from tepm_opt.control.collision.model import CollisionModel
from tepm_opt.control.references.path_following import FINE, PathFollowingReference
from tepm_opt.control.references.reference import PERIOD, START_UP, Reference, approach, point_by_point, reference_of, sample_tips
from tepm_opt.control.references.time_optimal import PaceSettings, retime
from tepm_opt.errors import InputError
from tepm_opt.models.compile import CompiledModel
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.kinematics.ik import IkSettings
from tepm_opt.solvers.planning.trajectories import Trajectory

AT_REST = 0.05  # of a path's largest speed, below which its ends are at rest
AT_ONCE = 1e-6  # s
SHORTEST_STAY, LONGEST_STAY, MOST_LAPS = 0.3, 1000.0, 1000.0


@dataclass(frozen=True)
class Course:
    """Timing of a trajectory: approach, laps, stays, and the way round obstacles.

    Attributes:
        approach: s from rest to its first point.
        pause: s there.
        laps: of a closed trajectory that count.
        stay: s for each of its points, of which the last third counts; None: along the path.
        start_up: s in which the path's speed rises and falls, outside what counts.
        steps: whether the target jumps from point to point, as the paper's; else a third of the stay goes into moving there smoothly.
        keep_out: obstacles, round which the way is led; None for none.
        pace: how fast a path is driven on which progress is free, whatever its time; None: as its time says.
    """

    approach: float = 3.0
    pause: float = 0.5
    laps: float = 1.0
    stay: float | None = None
    start_up: float = START_UP
    steps: bool = False
    keep_out: Obstacles | None = None
    pace: PaceSettings | None = None


FULL = Course()
IK_DEFAULT = IkSettings()


def whole_reference(
    model: CompiledModel,
    trajectory: Trajectory,
    course: Course = FULL,
    kinematics: IkSettings = IK_DEFAULT,
    progress: Progress = silent,
) -> Reference:
    """Reference from rest without forces to the trajectory's first point, a pause, then along it or point by point.

    Args:
        model: the controller's.
        trajectory: targets.
        course: how. An open path that starts and ends at rest by itself keeps its own timing.
        kinematics: settings of the inverse kinematics.
        progress: told how many periods are done.

    Raises:
        InputError: laps or a stay that do not fit; a path of one point; a tip out of reach; obstacles that cannot be kept out of.
    """
    if course.stay is not None and not SHORTEST_STAY <= course.stay <= LONGEST_STAY:
        raise InputError(f"stay = {course.stay:g} s; valid: {SHORTEST_STAY:g} … {LONGEST_STAY:g} s")
    if not 0 < course.laps <= MOST_LAPS:
        raise InputError(f"laps = {course.laps:g}; valid: more than 0 … {MOST_LAPS:g}")
    if course.laps != 1 and (course.stay is not None or not trajectory.closed):
        raise InputError(f"laps = {course.laps:g}: only a closed path has laps, such as circle or lissajous; leave them out")
    if course.stay is not None and course.pace is not None:
        raise InputError(f"stay = {course.stay:g} s: points have no progress that could be free; leave one of the two out")
    period = PERIOD if course.pace is None else PERIOD / FINE
    if course.pace is not None:
        trajectory = retime(model, trajectory, course.pace, kinematics, progress)
    if course.stay is not None:
        move = PERIOD if course.steps else course.stay / 3
        tips, counted, point = point_by_point(trajectory.positions, move, course.stay, course.stay / 3)
    else:
        rests = not trajectory.closed and len(trajectory.time) > 2 and _rests(trajectory)
        tips, counted = sample_tips(trajectory, AT_ONCE if rests else course.start_up, course.laps, period)
        point = np.zeros(len(tips), dtype=int)
    lead = approach(model, tips[0], course.approach, period)
    lead = np.vstack([lead, np.repeat(tips[:1], round(course.pause / period), axis=0)])
    tips = np.vstack([lead, tips])
    counted = np.concatenate([np.zeros(len(lead), dtype=bool), counted])
    point = np.concatenate([np.zeros(len(lead), dtype=int), point])
    found = reference_of(model, tips, counted, point, kinematics=kinematics, progress=progress)
    if course.pace is not None:
        parts = {each.name: getattr(found, each.name) for each in fields(found)}
        found = PathFollowingReference(**parts, pace=course.pace)
    return found if course.keep_out is None else detour(model, found, CollisionModel(model, course.keep_out), progress)


def _rests(trajectory: Trajectory) -> bool:
    speeds = np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=1) / np.diff(trajectory.time)
    return bool(max(speeds[0], speeds[-1]) < AT_REST * speeds.max())

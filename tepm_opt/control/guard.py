"""Limits at which a closed loop stops, and the supervisor that looks at every sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tepm_opt.hw.guard import BLIND_S, MARGIN, STALE_S, Stopped, Watch
from tepm_opt.hw.rig import Sample
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot
from tepm_opt.outcome import Ending


@dataclass(frozen=True)
class Guard:
    """Limits at which the closed loop stops, and how a real rig is brought to its start.

    Attributes:
        approach_time: time in s in which a rig that stands at zero is taken to the start, and back in the end; 0 for one that rests from
            the start where it is commanded to.
        settle_time: time in s for which it rests there before the loop is closed.
        start_tolerance: largest distance in m, in the median, of the tracked points at the start from the model's.
        largest_error: distance in m of the tip from its target beyond which the loop stops after `error_timeout`.
        error_timeout: time in s.
        tracking_timeout: time in s without any tracked point after which the closed loop stops: the tip is up to 4 mm further off after
            0.2 s, 15 mm after 0.3 s, 50 mm after 1 s.
        tip_timeout: time in s without the tip after which it stops, where other points are tracked; it is 7 mm further off after 1 s.
        limit_margin: part of its limit by which a measured tension or pressure may exceed it.
    """

    approach_time: float = 4.0
    settle_time: float = 1.5
    start_tolerance: float = 0.06
    largest_error: float = 0.20
    error_timeout: float = 0.5
    tracking_timeout: float = STALE_S
    tip_timeout: float = BLIND_S
    limit_margin: float = MARGIN


class Supervisor:
    """Check of every sample: stops what must not go on, which is what any rig is watched for and a tip that is not where it shall be.

    Args:
        guard: the limits.
        robot: whose inputs are limited.
    """

    def __init__(self, guard: Guard, robot: Robot) -> None:
        self._guard = guard
        names = Layout.from_robot(robot).actuator_names
        self._watch = Watch(names, robot.input_max, guard.limit_margin, tracked=True)
        self._far, self._near, self._seen, self._tracked = False, np.inf, np.inf, np.inf

    def check(self, sample: Sample, target: np.ndarray | None = None) -> None:
        """A sample, and where the tip shall be (3,) in m while the loop is closed.

        Raises:
            Stopped: it must not go on.
        """
        self._watch.check(sample)
        guard, now = self._guard, sample.time
        tracked = target is None or bool(np.isfinite(sample.points).all(axis=1).any())
        self._tracked = now if tracked else min(self._tracked, now)
        off = 0.0 if target is None else float(np.linalg.norm(sample.points[-1] - target))
        self._seen = now if np.isfinite(off) else min(self._seen, now)
        self._far = off > guard.largest_error if np.isfinite(off) else self._far  # a lost tip is where it was
        self._near = min(self._near, now) if self._far else now
        if now - self._tracked > guard.tracking_timeout:
            raise Stopped(Ending.BLIND, f"no tracked point for {guard.tracking_timeout:g} s")
        if now - self._seen > guard.tip_timeout:
            raise Stopped(Ending.BLIND, f"the tip was not tracked for {guard.tip_timeout:g} s")
        if now - self._near > guard.error_timeout:
            raise Stopped(Ending.DISAGREED, f"the tip was more than {1e3 * guard.largest_error:.0f} mm off for {guard.error_timeout:g} s")

"""Driving a rig along set points: slowly to the first row, at rest there, then every row at its time, and down again."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from statistics import median

import numpy as np

from tepm_opt.data.channels import Channels
from tepm_opt.data.checks.findings import noise_level, spread
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.hw.guard import Watch
from tepm_opt.hw.ramp import smooth_ramp
from tepm_opt.hw.rig import Command, Rig, Sample
from tepm_opt.progress import Progress, silent

FULL_RANGE, SHORTEST = 6.0, 2.0
"""Seconds in which inputs glide over their full range, and the least that a glide takes."""
REST_WINDOW, REST_SPREAD = 1.2, 5e-4
"""Seconds (more than a period of the sway) within which a robot at rest does not leave this many metres, beyond noise."""
AHEAD = 25
"""Samples that a rig of virtual time may give at once."""


@dataclass(frozen=True, eq=False)
class Row:
    """A sample and what was commanded at its time.

    Attributes:
        time: since the set points began in s.
        inputs: (inputs,) in Pa and N.
        tip_force: (3,) in N.
        sample: as the rig gave it.
        late: seconds by which commands before it came too late; 0 where all were in time.
    """

    time: float
    inputs: np.ndarray
    tip_force: np.ndarray
    sample: Sample
    late: float = 0.0

    def __repr__(self) -> str:
        return f"Row({self.time:.3f} s, {self.sample!r})"


class Driver:
    """A rig that is being driven, and watched. What it sends changes smoothly, apart from the set points themselves.

    Args:
        rig: started and stopped by the caller.
        channels: of the robot.
        progress: told of every stage in s.

    Attributes:
        inputs: commanded last, (inputs,) in Pa and N; zeros at first.
    """

    def __init__(self, rig: Rig, channels: Channels, progress: Progress = silent) -> None:
        self.rig, self.channels, self.progress = rig, channels, progress
        self.inputs = np.zeros(len(channels.inputs))
        self._sample: Sample | None = None
        self._times: deque[float] = deque(maxlen=21)
        self._stalled = 0
        self._watch = Watch(channels.actuators, channels.limits)

    def __repr__(self) -> str:
        return f"Driver({self.rig!r})"

    def read(self) -> Sample:
        """The rig's next sample.

        Raises:
            InputError: it has not the robot's points, or is a recording that ended.
            Stopped: a measured value is beyond its limit, or measurements stopped coming.
            RuntimeError: the rig's time stands still.
        """
        try:
            return self._check_sample(self.rig.read())
        except EOFError as error:
            raise InputError(f"the rig has no more samples: {error}") from error

    def _check_sample(self, sample: Sample) -> Sample:
        """Check a sample that came; see `read`."""
        if sample.points.shape != (len(self.channels.points), 3):
            raise InputError(f"the rig gives {len(sample.points)} points, the robot has {len(self.channels.points)}; another robot?")
        self._stalled = self._stalled + 1 if self._times and sample.time <= self._times[-1] else 0
        if self._stalled > 200:
            raise RuntimeError(f"the rig's time stands still at {sample.time:g} s")
        if not self._stalled:
            self._times.append(sample.time)
        self._sample = sample
        self._watch.check(sample)
        return sample

    def apply(self, inputs: np.ndarray) -> None:
        """Command u (inputs,) in Pa and N."""
        self.inputs = np.clip(inputs, 0.0, self.channels.limits)
        self.rig.apply(Command.from_inputs(self.inputs))

    @property
    def sample(self) -> Sample:
        """The last sample; read now where there is none."""
        return self.read() if self._sample is None else self._sample

    @property
    def period(self) -> float:
        """Typical time between samples in s."""
        return median(after - before for before, after in pairwise(self._times)) if len(self._times) > 1 else 0.01

    @property
    def now(self) -> float:
        """The rig's time in s at which a command given now is given."""
        return self.rig.time

    def start(self, setpoints: SetPoints, at_once: bool = False) -> bool:
        """Bring the robot to rest under the first row, slowly or, where time is virtual and if wished, at once; whether it rests."""
        if simulated := self.rig.simulated:
            simulated.push(setpoints.tip_force[0])
            if at_once:
                self.apply(setpoints.inputs[0])
                self.read()
                self.read()
                return True
        self.approach(setpoints.inputs[0])
        return self.settle()

    def approach(self, target: np.ndarray) -> None:
        """Glide from where the rig is — measured, where it measures — to `target` (inputs,)."""
        sample = self.read()
        half = len(self.inputs) // 2
        for part, measured in ((slice(0, half), sample.pressures), (slice(half, None), sample.tensions)):
            if measured is not None and np.isfinite(measured).all():
                self.inputs[part] = np.clip(measured, 0.0, self.channels.limits[part])
        self.glide(target, "approaching the start")

    def glide(self, target: np.ndarray, stage: str) -> None:
        """Take the inputs from those commanded last to `target` (inputs,), smoothly, over a few seconds."""
        start, limits = self.inputs.copy(), self.channels.limits
        duration = max(SHORTEST, FULL_RANGE * float(np.max(np.abs(target - start) / limits, initial=0.0)))
        for passed, share in smooth_ramp(lambda: self.now, duration):
            self.apply(start + (target - start) * share)
            self.progress(stage, passed, duration)
            self.read()

    def settle(self, least: float = 1.0, most: float = 40.0) -> bool:
        """Wait until the robot rests, at least and at most so many seconds; whether it does."""
        begin, seen = self.now, deque[Sample]()
        ask = begin + max(least, REST_WINDOW)
        while self.now - begin < most:
            self.apply(self.inputs)
            seen.append(self.read())
            while seen[-1].time - seen[0].time > REST_WINDOW:
                seen.popleft()
            self.progress("waiting for rest", self.now - begin, most)
            if self.now >= ask:
                ask = self.now + REST_WINDOW / 4
                if at_rest(np.array([sample.points for sample in seen])):
                    return True
        return False

    def follow(self, setpoints: SetPoints, rate: float) -> Iterator[Row]:
        """Send the set points and give a row for each sample that is kept, at `rate` Hz or as fast as the rig is.

        Their time 0 is that of the next sample. Where set points cannot be given in advance each one sent is that of the middle of the time
        until the next, so that on average nothing is late.

        Raises:
            InputError: the rig does not give samples at this rate.
        """
        self._refuse_rate(rate)
        time = setpoints.time - setpoints.time[0]
        origin = self._schedule_setpoints(setpoints, time)
        simulated, tolerance = self.rig.simulated, 0.45 * min(self.period, 1 / rate)
        ahead: Iterator[Sample] = iter(())
        due, last, late, sent = 0, int(np.floor(time[-1] * rate + 1e-6)), 0.0, self.now
        before, asked = -np.inf, np.column_stack([setpoints.inputs, setpoints.tip_force])
        while due <= last:
            if simulated is None:
                late = max(late, self.now - sent if self.now - sent > max(3 * self.period, 1.5 / rate) else 0.0)
                sent = self.now
                self.apply(_interpolate(time, setpoints.inputs, self.now - origin + self.period / 2))
                sample = self.read()
            elif (found := next(ahead, None)) is not None:
                sample = self._check_sample(found)
            else:
                left = int((last / rate + origin - self._times[-1]) / self.period)
                ahead = iter(simulated.read_many(min(max(left, 1), AHEAD)))
                continue
            passed = sample.time - origin
            self.progress("recording", min(passed, time[-1]), time[-1])
            if passed >= due / rate - tolerance and passed > before + 1e-6:
                given, half = _interpolate(time, asked, passed), len(self.inputs)
                inputs, force = given[:half], given[half:]
                self.inputs = inputs if simulated else self.inputs
                yield Row(passed, inputs, force, sample, late)
                due, late, before = max(due + 1, int(np.floor(passed * rate + 0.25)) + 1), 0.0, passed

    def _refuse_rate(self, rate: float) -> None:
        """Every sample, every second one, …: other rates would make rows irregular."""
        ratio = 1 / (rate * self.period)
        if ratio < 0.9 or (ratio < 5 and abs(ratio - round(ratio)) > 0.1):
            own = round(1 / self.period, 1)
            raise InputError(
                f"sample rate {rate:g} Hz: the rig gives {own:g} samples a second; valid: {own:g}, {own / 2:g}, {own / 3:.4g}, …"
            )

    def _schedule_setpoints(self, setpoints: SetPoints, time: np.ndarray) -> float:
        """Give set points to a simulated rig; return the rig's time at which they begin, that of the next sample."""
        last = self._times[-1]
        origin = last + self.period * max(int(np.ceil((self.now - last) / self.period - 1e-6)), 1)
        if simulated := self.rig.simulated:
            wait = origin - self.now
            values = (setpoints.inputs, setpoints.tip_force)
            if wait > 1e-4:
                time, values = np.append(0.0, time + wait), tuple(np.vstack([rows[:1], rows]) for rows in values)
            simulated.schedule(SetPoints(time, *values))
        return origin

    def finish(self) -> None:
        """Glide to zero and stop."""
        self.glide(np.zeros(len(self.inputs)), "returning to zero")
        self.rig.stop()


def refuse_unplayable(setpoints: SetPoints, where: str) -> None:
    """Refuse set points that have no duration or rows without inputs (where inverse kinematics failed).

    Raises:
        InputError: naming the row.
    """
    if len(setpoints.time) < 2:
        raise InputError(f"{where}: one row has no duration; valid: at least two rows of increasing time")
    empty = ~np.isfinite(setpoints.inputs).all(axis=1)
    if empty.any():
        raise InputError(f"{where}: row {int(np.argmax(empty)) + 1} has no inputs; a rig cannot play it")


def _interpolate(time: np.ndarray, values: np.ndarray, when: float) -> np.ndarray:
    """Interpolate values (rows, …) at a time, linearly between rows, (…,)."""
    if len(time) == 1 or when <= time[0]:
        return values[0]
    k = min(int(time.searchsorted(when, side="right")) - 1, len(time) - 2)
    part = min((when - time[k]) / (time[k + 1] - time[k]), 1.0)
    return values[k] + part * (values[k + 1] - values[k])


def at_rest(points: np.ndarray) -> bool:
    """Whether points (samples, points, 3) in m stay where they are, but for their noise; lost points are not asked."""
    if len(points) < 12:
        return False
    blocks = np.array_split(points, min(8, len(points) // 3))
    noise = np.nan_to_num(noise_level(points)) / np.sqrt(len(blocks[0]))
    means = np.array([np.where(np.isfinite(block).any(axis=0), _mean(block), np.nan) for block in blocks])
    return bool(np.all(spread(means) < REST_SPREAD + 5 * noise))


def _mean(block: np.ndarray) -> np.ndarray:
    finite = np.isfinite(block)
    return np.where(finite, block, 0.0).sum(axis=0) / np.maximum(finite.sum(axis=0), 1)

"""Measurements that are none: poses and gauges that repeat bit by bit while noise is expected, and points that are exchanged.

A value in the middle of a cell of its grid q, with Gaussian noise of standard deviation σ, is read in this cell with the probability
p = erf(q / (√8 σ)), and in a row of n more readings with pⁿ; elsewhere repeats are rarer. Three coordinates multiply. A channel is stale
after n repeats in a row, the least n with pⁿ · (readings in `FALSE_ALARM_HOURS`) < 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.hw.guard import GAUGES
from tepm_opt.hw.rig import Sample
from tepm_opt.models.hardware import COUNTS_PER_V, Hardware
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot

FALSE_ALARM_HOURS = 1000.0
"""Hours in which a channel is called stale by chance less than once: half a year of working days, beyond any single experiment."""
TRACKER_GRID = 1e-5
"""Resolution in m that is assumed of a tracker: electromagnetic trackers send hundredths of a millimetre. Finer ones repeat more rarely."""
LEAST_REPEATS = 5
"""Repeats in a row before a channel counts as frozen: a tracker at a fifth of the sample rate repeats each pose four times."""
SEPARATE = 1e-3
"""Chance of a repeat below which a single repeated pose is withheld: losing one honest pose in a thousand does no harm."""
LONGEST_S = 0.5
"""Seconds of repeats beyond which repeats alone do not judge a channel: the noise is too small for its grid."""
MOVED, FOLLOWS_S = 0.1, 0.5
"""Part of its range by which a command has to change, and seconds after that (two lags of a regulator) in which a gauge has to change."""
WINDOW_S, EPISODES = 0.3, 3
"""Seconds in which so many separate repeats or gaps are told: one or two happen to any tracker."""
LOST_S = 0.1
"""Seconds without a valid pose of a point after which that is told."""
APART, EXCHANGED, RECENT_S = 10.0, 0.25, 0.3
"""Sigmas that a point has to jump by; part of the jump that an exchange of two points may leave; age in s of the places compared with."""


@dataclass(frozen=True)
class DeclaredNoise:
    """Standard deviations and grids that are declared of a rig's measurements; 0: none is known, or the grid is that of the numbers.

    Attributes:
        point, pressure, tension: noise of a coordinate in m, of a pressure gauge in Pa and of a dynamometer in N, 1 sigma.
        point_grid, pressure_grid, tension_grid: resolutions in the same units.
    """

    point: float = 0.0
    pressure: float = 0.0
    tension: float = 0.0
    point_grid: float = TRACKER_GRID
    pressure_grid: float = 0.0
    tension_grid: float = 0.0

    @staticmethod
    def of_robot(robot: Robot) -> DeclaredNoise:
        """Noise that a robot file declares, on the grid of the counts that its gauges are read in."""
        hardware = robot.hardware or Hardware()
        pressure, tension = hardware.pressure, hardware.tension
        return DeclaredNoise(
            robot.tracker.noise_rms_m / math.sqrt(3),
            float(np.min(pressure.monitor_noise_Pa)),
            float(np.min(tension.noise_N)),
            pressure_grid=1e6 / (COUNTS_PER_V * float(np.min(pressure.monitor_V_per_MPa))),
            tension_grid=1 / float(np.min(tension.counts_per_N)),
        )


def chance_of_repeat(sigma: float, grid: float) -> float:
    """Probability that a reading repeats the one before, which repeated already: that of the likeliest cell of its grid.

    Args:
        sigma: standard deviation of the noise; 0: readings always repeat.
        grid: resolution; 0: continuous readings never repeat.
    """
    return math.erf(grid / sigma / math.sqrt(8)) if sigma > 0 else 1.0


def repeats_until_stale(chance: float, rate: float) -> int | None:
    """Number of repeats in a row after which a channel is stale; None where repeats do not judge it.

    Args:
        chance: of one repeat.
        rate: readings a second.
    """
    readings = rate * 3600 * FALSE_ALARM_HOURS
    if chance >= 1:
        return None
    needed = LEAST_REPEATS if chance <= 0 else max(LEAST_REPEATS, math.ceil(math.log(readings) / -math.log(chance) + 1e-9))
    return needed if needed <= max(LEAST_REPEATS, LONGEST_S * rate) else None


class _Channels:
    """Repeats of several channels of one kind.

    Args:
        count, axes: number of channels, and of values in each.
        chance: that one repeats.
        rate: readings a second.
        ranges: of the commands, (commands,).
        own: whether channel k has command k, or all have all of them.

    Attributes:
        repeats: in a row, (count,).
        varied: whether a channel was ever seen to change; before that its noise is not proven, (count,).
        calm: whether all were fresh the last time, and have varied.
    """

    def __init__(self, count: int, axes: int, chance: float, rate: float, ranges: np.ndarray, own: bool) -> None:
        self.chance, self.needed, self._rate = chance, repeats_until_stale(chance, rate), rate
        self.repeats, self.varied = np.zeros(count, dtype=int), np.zeros(count, dtype=bool)
        self._last, self._ranges, self._own = np.full((count, axes), np.nan), ranges, own
        self._base = np.full((count, 1 if own else len(ranges)), np.nan)
        self._moved = np.full(count, np.inf)  # when the command had moved since the channel last changed, in s
        self._none = np.zeros(count, dtype=bool)
        self.calm = False

    def update(self, values: np.ndarray, now: float, commands: np.ndarray | None) -> np.ndarray:
        """Take readings (count, axes), NaN where missing, and the commands (commands,); which of them repeat the last ones, (count,)."""
        same = (values == self._last).all(axis=1)
        if self.calm and not same.any() and np.isfinite(values).all():  # as nearly always: nothing to count
            self._last[:] = values
            if commands is not None:
                self._base[:] = commands[:, None] if self._own else commands
            return self._none
        known = np.isfinite(values).all(axis=1)
        repeated = known & same
        fresh = known & ~repeated
        self.varied |= fresh & np.isfinite(self._last).all(axis=1)
        self.repeats = np.where(fresh, 0, self.repeats + repeated)
        self._last[fresh] = values[fresh]
        if commands is not None:
            each = commands[:, None] if self._own else np.broadcast_to(commands, self._base.shape)
            self._base[fresh], self._moved[fresh] = each[fresh], np.inf
            if repeated.any():
                ranges = self._ranges[:, None] if self._own else self._ranges
                moved = repeated & (np.abs(each - self._base) > MOVED * ranges).any(axis=1)
                self._moved[moved] = np.minimum(self._moved[moved], now)
        self.calm = bool(fresh.all() and self.varied.all())
        return repeated

    def find_frozen(self, now: float) -> np.ndarray:
        """Flags of the channels that are frozen at a time in s, (count,)."""
        if self.calm:
            return self._none
        stuck = (self.repeats >= LEAST_REPEATS) & (now - self._moved > FOLLOWS_S)
        return stuck if self.needed is None else stuck | (self.varied & (self.repeats >= self.needed))


class _Episodes:
    """Separate repeats and gaps within a window, by channel."""

    def __init__(self, count: int, rate: float) -> None:
        self._size = int(np.clip(round(WINDOW_S * rate), 8, 300))
        self._bad, self._ended, self._before, self._at = *np.zeros((2, self._size, count), dtype=bool), np.zeros(count, dtype=bool), 0
        self._any = 0

    def add(self, bad: np.ndarray, good: np.ndarray) -> None:
        """Take which channels are bad now, and which are good, (count,)."""
        self._at = (self._at + 1) % self._size
        self._bad[self._at], self._ended[self._at] = bad, self._before & good
        self._before = bad | (self._before & ~good)
        self._any = self._size if bad.any() else max(self._any - 1, 0)

    @property
    def quiet(self) -> bool:
        """Whether nothing was bad for a window."""
        return not self._any

    def find_frequent(self) -> np.ndarray:
        """Flags of the channels that have had too many, (count,)."""
        return self._ended.sum(axis=0) >= EPISODES if self._any else np.zeros(len(self._before), dtype=bool)

    def share(self, channel: int) -> float:
        """Part of the readings of the window that are bad."""
        return float(self._bad[:, channel].mean())


class FreshnessMonitor:
    """Withholds measurements that are none from the samples of a rig, and tells why.

    Poses that repeat become NaN, as do points that are exchanged and gauges that are frozen. What is told stands in `Sample.faults`.

    Args:
        layout: names of points and actuators.
        limits: largest pressures in Pa and tensions in N, (2 · actuators,).
        noise: as declared.
        rate: samples a second.
    """

    def __init__(self, layout: Layout, limits: np.ndarray, noise: DeclaredNoise, rate: float) -> None:
        self._points, self._actuators, self._rate = layout.point_names, layout.actuator_names, rate
        count, pressures, tensions = len(self._points), *np.split(np.asarray(limits, dtype=float), 2)
        chance = chance_of_repeat(noise.point, noise.point_grid) ** 3
        self._places_of = _Channels(count, 3, chance, rate, np.concatenate([pressures, tensions]), own=False)
        self._needed_together = repeats_until_stale(chance**count, rate)
        one = chance_of_repeat(noise.pressure, noise.pressure_grid), chance_of_repeat(noise.tension, noise.tension_grid)
        self._gauges = {
            "pressure": _Channels(len(pressures), 1, one[0], rate, pressures, own=True),
            "tension": _Channels(len(tensions), 1, one[1], rate, tensions, own=True),
        }
        self._repeating, self._dropping = _Episodes(count + 1, rate), _Episodes(count + 1, rate)
        self._jump = max(APART * noise.point, 1e-4)
        self._place, self._placed = np.full((count, 3), np.nan), np.full(count, -np.inf)
        self._seen = np.full(count, np.nan)  # when a pose was last given, repeated or not
        self._order = np.arange(count)  # the point that is sent under each name
        self._none = np.zeros(count, dtype=bool)

    @staticmethod
    def of_robot(robot: Robot, rate: float) -> FreshnessMonitor:
        """The monitor of a real rig, by what the robot file declares."""
        return FreshnessMonitor(Layout.from_robot(robot), robot.input_max, DeclaredNoise.of_robot(robot), rate)

    def look(self, sample: Sample, commands: np.ndarray | None = None, gauged: bool = True) -> Sample:
        """A sample without what is none.

        Args:
            sample: as measured.
            commands: pressures in Pa and tensions in N in force, (2 · actuators,); None where unknown.
            gauged: whether the gauges were read anew for this sample.
        """
        faults: dict[str, str] = {}
        withheld = self._look_at_points(sample, commands, faults)
        half = len(self._actuators)
        parts = (None, None) if commands is None else (commands[:half], commands[half:])
        measured = {}
        for kind, values, own in zip(self._gauges, (sample.pressures, sample.tensions), parts, strict=True):
            measured[kind] = values if values is None else self._look_at_gauges(kind, values, sample.time, own, gauged, faults)
        if not faults and not withheld.any():
            return sample
        points, transforms = sample.points, sample.transforms
        if withheld.any():
            points = np.where(withheld[:, None], np.nan, points)
            transforms = None if transforms is None else np.where(withheld[:, None, None], np.nan, transforms)
        words = [about for about in faults if not about.endswith((" lost", " drops frames"))]  # the rig has told of lost ones itself
        status = "; ".join([*([] if sample.status == "ok" and words else [sample.status]), *words])
        stale = tuple(np.flatnonzero(withheld).tolist())
        return replace(
            sample, points=points, transforms=transforms, pressures=measured["pressure"], tensions=measured["tension"], status=status,
            stale=stale, faults={**sample.faults, **faults},
        )  # fmt: skip

    def _look_at_points(self, sample: Sample, commands: np.ndarray | None, faults: dict[str, str]) -> np.ndarray:
        """Flags of the points to withhold, (points,)."""
        channels, now, points = self._places_of, sample.time, sample.points
        repeated = channels.update(points, now, commands)
        if channels.calm and self._repeating.quiet and self._dropping.quiet and self._stays(points, now):
            return self._none
        known: np.ndarray = np.asarray(np.isfinite(points).all(axis=1))
        frozen, count = channels.find_frozen(now), int(known.sum())
        together = count > 1 and bool(repeated[known].all())
        proven, single = bool(channels.varied[known].all()), channels.chance <= SEPARATE
        if together and self._needed_together is not None and proven:
            frozen = frozen | (known & (channels.repeats[known].min() >= self._needed_together))
        withheld = known & frozen
        if single:
            withheld |= repeated & channels.varied
        elif together and proven and channels.chance**count <= SEPARATE:
            withheld |= repeated
        self._look_for_swaps(points, known & ~repeated, now)
        exchanged = self._order != np.arange(len(known))
        self._tell_points(now, known, withheld, frozen & known, together, faults)
        for k in np.flatnonzero(exchanged):
            if k < self._order[k]:
                pair = f"{self._points[k]} and {self._points[self._order[k]]}"
                faults[f"{pair} are swapped"] = f"{pair} are swapped: each has jumped to the other's place; neither is used"
        return withheld | (exchanged & known)

    def _stays(self, points: np.ndarray, now: float) -> bool:
        """Whether points that are all fresh are near their last places under their own names, as nearly always; then that is noted."""
        way = points - self._place
        if not (way * way).sum(axis=1).max() <= self._jump**2 or (self._order[1:] < self._order[:-1]).any():
            return False
        self._place[:], self._placed[:], self._seen[:] = points, now, now
        return True

    def _tell_points(
        self, now: float, known: np.ndarray, withheld: np.ndarray, frozen: np.ndarray, together: bool, faults: dict[str, str]
    ) -> None:
        """Tell what is wrong with the poses, by its name."""
        repeats = withheld & ~frozen
        every = bool(known.any())
        self._repeating.add(np.append(repeats, together and bool(repeats.any())), np.append(known & ~withheld, every and not together))
        seen_before = np.isfinite(self._seen)
        self._dropping.add(np.append(~known & seen_before, seen_before.any() and not every), np.append(known, every))
        self._seen[known] = now
        names, held = self._points, self._places_of.repeats / self._rate
        if frozen.any() and frozen[known].all() and known.sum() > 1:
            text = f"all tracked points repeat their last poses bit by bit for {held[known].min():.2f} s"
            faults["tracker frozen"] = f"tracker frozen: {text}; they are taken for lost"
        else:
            for k in np.flatnonzero(frozen):
                text = f"it repeats its last pose bit by bit for {held[k]:.2f} s"
                faults[f"{names[k]} frozen"] = f"{names[k]} frozen: {text}; it is taken for lost"
        for episodes, verb in ((self._repeating, "repeats"), (self._dropping, "drops")):
            for k in np.flatnonzero(told := episodes.find_frequent()).tolist():
                whole = k == len(names)
                if whole or not told[-1]:
                    of = "its frames" if whole else f"the poses of {names[k]}"
                    text = f"tracker {verb} {100 * episodes.share(k):.0f} % of {of}; they are taken for lost"
                    faults[f"{'tracker' if whole else names[k]} {verb} frames"] = text
        if not known.all():
            lost = ~known & (now - self._seen > LOST_S)
            if lost.all():
                faults["tracker lost"] = f"tracker lost: no valid pose of any point for more than {LOST_S:g} s"
            else:
                for k in np.flatnonzero(lost):
                    faults[f"{self._points[k]} lost"] = f"{self._points[k]} lost: no valid pose of it for more than {LOST_S:g} s"

    def _look_for_swaps(self, points: np.ndarray, fresh: np.ndarray, now: float) -> None:
        """Keep which point is sent under each name: two that have jumped to each other's last place are exchanged."""
        there, usable = points[self._order], fresh[self._order]
        off = np.where(usable & (now - self._placed <= RECENT_S), np.linalg.norm(there - self._place, axis=1), 0.0)
        jumped = np.flatnonzero(off > self._jump)
        for at, i in enumerate(jumped):
            for j in jumped[at + 1 :]:
                left = max(np.linalg.norm(there[i] - self._place[j]), np.linalg.norm(there[j] - self._place[i]))
                if left < EXCHANGED * min(off[i], off[j]):
                    self._order[[i, j]] = self._order[[j, i]]
                    there[[i, j]] = there[[j, i]]
                    usable[[i, j]] = usable[[j, i]]
        self._place[usable], self._placed[usable] = there[usable], now

    def _look_at_gauges(
        self, kind: str, values: np.ndarray, now: float, commands: np.ndarray | None, gauged: bool, faults: dict[str, str]
    ) -> np.ndarray:
        """Put NaN where a gauge is frozen into readings (actuators,)."""
        channels = self._gauges[kind]
        if gauged:
            channels.update(values[:, None], now, commands)
        frozen = channels.find_frozen(now)
        if not frozen.any():
            return values
        for k in np.flatnonzero(frozen):
            name = GAUGES[kind].format(self._actuators[k])
            faults[f"{name} frozen"] = f"{name} frozen: it repeats its last reading bit by bit; it is taken for not measured"
        return np.where(frozen, np.nan, values)

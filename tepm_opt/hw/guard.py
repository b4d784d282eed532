"""Guard that stops a rig that is driven: at measured values beyond their limits, and where measurements stop coming."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from tepm_opt.outcome import Ending, Outcome

if TYPE_CHECKING:
    from tepm_opt.hw.rig import Sample

MARGIN = 0.05
"""Part of its limit by which a measured pressure or tension may exceed it."""
BLIND_S, STALE_S, UNMEASURED_S = 1.0, 0.2, 0.2
"""Seconds without any tracked point, with a tip that is sent but is none (repeated, exchanged), and without a pressure or tension that was
measured before, after which a rig is stopped."""


GAUGES = {"pressure": "pressure gauge {}", "tension": "dynamometer {}"}
"""Names of the gauges, by what they measure."""


class Stopped(RuntimeError):  # noqa: N818  it says what happened
    """Stop of a rig by its guard; the message says why.

    Attributes:
        outcome: why.
    """

    def __init__(self, ending: Ending, message: str) -> None:
        super().__init__(message)
        self.outcome = Outcome(ending, message)


class Watch:
    """Looks at every sample of a rig and stops what must not go on. What is not a number is not within a limit.

    Args:
        actuators: names of the actuators.
        limits: largest pressures in Pa and tensions in N, (2 · actuators,).
        margin: part of its limit by which a measured value may exceed it.
        blind: seconds without any tracked point after which it stops.
        tracked: whether a rig that never had a tracked point is stopped for that, too.
    """

    def __init__(
        self, actuators: tuple[str, ...], limits: np.ndarray, margin: float = MARGIN, blind: float = BLIND_S, tracked: bool = False
    ) -> None:
        pressures, tensions = np.split(np.asarray(limits, dtype=float), 2)
        self._limits = {"pressure": pressures, "tension": tensions}
        self._most = {kind: (1 + margin) * limits for kind, limits in self._limits.items()}
        self._actuators, self._blind, self._tracked = actuators, blind, tracked
        self._measured: dict[str, np.ndarray] = {}  # when each was last
        self._seen: float | None = None
        self._fresh = np.inf  # when the tip was last fresh, in s

    def check(self, sample: Sample) -> None:
        """Look at a sample.

        Raises:
            Stopped: the rig must not go on.
        """
        self._check_measured("pressure", sample)
        self._check_measured("tension", sample)
        if np.isfinite(sample.points).all(axis=1).any() or (self._seen is None and self._tracked):
            self._seen = sample.time
        if self._seen is not None and sample.time - self._seen > self._blind:
            raise Stopped(Ending.BLIND, f"no tracked point for {self._blind:g} s")
        self._check_fresh(sample)

    def _check_fresh(self, sample: Sample) -> None:
        """Stop where the tip is sent, but is none: that is no dropout which passes, and tells of no motion."""
        tip = len(sample.points) - 1
        if tip not in sample.stale:
            self._fresh = sample.time if np.isfinite(sample.points[tip]).all() else self._fresh
            return
        self._fresh = min(self._fresh, sample.time)
        if sample.time - self._fresh > STALE_S:
            why = "; ".join(sample.faults) or "the tip's pose is none"
            raise Stopped(Ending.BLIND, f"{why}: no fresh pose of the tip for {STALE_S:g} s")

    def _check_measured(self, kind: str, sample: Sample) -> None:
        """The pressures or tensions of a sample, (actuators,); None where there are none."""
        values, now = sample.pressures if kind == "pressure" else sample.tensions, sample.time
        limits = self._limits[kind]
        if values is None:
            if kind not in self._measured:  # a rig that does not measure them
                return
            values = np.full(len(limits), np.nan)
        if kind not in self._measured:
            self._measured[kind] = np.full(len(limits), now)
        last = self._measured[kind]
        if (np.abs(values) <= self._most[kind]).all():  # and so measured
            last[:] = now
            return
        over = values > self._most[kind]
        if over.any():
            at = int(np.argmax(over))
            raise Stopped(Ending.LIMIT, f"measured {kind}_{self._actuators[at]} is {100 * values[at] / limits[at]:.0f} % of its limit")
        last[np.isfinite(values)] = now
        if (now - last > UNMEASURED_S).any():
            at = int(np.argmin(last))
            why = cause_of(sample.faults, GAUGES[kind].format(self._actuators[at]))
            told = f"{kind}_{self._actuators[at]} was not measured for {UNMEASURED_S:g} s"
            raise Stopped(Ending.UNMEASURED, f"{why}: {told}" if why else told)


def cause_of(faults: Mapping[str, str], about: str) -> str:
    """The fault of a gauge or point, such as "pressure gauge 13 frozen", or "" where there is none."""
    return next((name for name in faults if name.startswith(f"{about} ")), "")

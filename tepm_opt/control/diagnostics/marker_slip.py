"""A tracked point that jumps against all others: its marker has slipped, for an arm cannot do that."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tepm_opt.hw.rig import Sample

HALF = 7  # frames before and after a jump by which it is judged
JUMPED = 40.0  # squared jump of a point over its variance: chance alone gets there once in 10^8 frames
STILL = 14.0  # the same of all others: what shakes the arm shakes them, too
LEFT = 3.0  # of what a jump leaves unexplained over the noise's variance: beyond, the jump is elsewhere, or none
FARTHEST = 0.03  # m, beyond which it is no slip: another marker, or none


def _fit() -> tuple[np.ndarray, np.ndarray]:
    """A jump in the middle of frames by least squares beside a place, a speed and an acceleration, (2 · HALF,), and what that leaves of the
    frames, (2 · HALF, 2 · HALF)."""
    time = np.arange(2 * HALF) - HALF + 0.5
    columns = np.column_stack([time > 0, np.ones_like(time), time, time**2])
    inverse = np.linalg.pinv(columns)
    return inverse[0], np.eye(len(time)) - columns @ inverse


_JUMP, _REST = _fit()
_VARIANCE, _FREEDOM = float(_JUMP @ _JUMP), float(np.trace(_REST))


class Markers:
    """Slips of tracked points along the arm, detected and corrected.

    What a marker slipped by is taken off from then on, or else the tip would be brought to where its marker was. Jumps of four
    millimetres and more stand out of a millimetre of noise.

    Args:
        names: of the points.
        period: of the samples in s.

    Attributes:
        slipped: (points, 3) in m in G.
    """

    def __init__(self, names: tuple[str, ...], period: float) -> None:
        self._names, self._period, self._time = names, period, -np.inf
        self.slipped = np.zeros((len(names), 3))
        self._any = False
        self._frames = np.full((2 * HALF + 1, 3 * len(names)), np.nan)  # the oldest first; one more than a jump is judged by
        self._sizes = np.zeros(len(names))  # of jumps in the middle of all frames but the last, squared over variance

    def undo_slips(self, sample: Sample) -> Sample:
        """Return a sample with its points where they would be if none had slipped."""
        return replace(sample, points=sample.points - self.slipped) if self._any else sample

    def look(self, sample: Sample, noise: float) -> None:
        """Take a sample as `placed` gave it, and see whether one of its points has slipped.

        A jump is where its share of the noise is largest, one frame before now. Frames that are not a period apart (some were lost) are
        not judged together: there the arm itself moves by jumps.

        Args:
            sample: with points in m in G, NaN where missing.
            noise: of a coordinate, 1 sigma in m.
        """
        frames, apart = self._frames, sample.time - self._time
        self._time = sample.time
        if not 0.5 * self._period < apart < 1.5 * self._period:
            frames[:] = np.nan
        frames[:-1] = frames[1:]
        frames[-1] = sample.points.ravel()
        jumps = (_JUMP @ frames[1:]).reshape(-1, 3)
        now = np.einsum("px,px->p", jumps, jumps) / (noise**2 * _VARIANCE)
        before, self._sizes = self._sizes, now
        tallest = np.fmax.reduce(before)
        if not tallest > JUMPED:
            return
        which = int(np.flatnonzero(before == tallest)[0])
        own = frames[:-1, 3 * which : 3 * which + 3]
        jump = _JUMP @ own
        others = np.delete(before, which)
        others = others[np.isfinite(others)]
        alone = len(others) > 0 and bool((others <= STILL).all())
        left = float(((_REST @ own) ** 2).sum()) / (3 * noise**2 * _FREEDOM)
        if not alone or tallest <= now[which] or left > LEFT or np.linalg.norm(jump) > FARTHEST:
            return
        self.slipped[which] += jump
        self._any = True
        frames[HALF:, 3 * which : 3 * which + 3] -= jump
        self._sizes = np.zeros(len(now))

    def describe_slips(self) -> Mapping[str, str]:
        """Sentence for every point that slipped, by the point's key in the log."""
        if not self._any:
            return {}
        found = {}
        for name, off in zip(self._names, 1e3 * np.linalg.norm(self.slipped, axis=1), strict=True):
            if off > 0:
                found[f"marker {name}"] = (
                    f"tracked point {name} has jumped by {off:.1f} mm against the others: its marker slipped; the controller takes "
                    "that off until the run ends"
                )
        return found

"""A tracked point that jumps against all others: its marker has slipped, for an arm cannot do that."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np

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


class Markers:
    """Where tracked points are on the arm beside where they were.

    What a marker slipped by is taken off from then on, or else the tip would be brought to where its marker was. Jumps of four
    millimetres and more stand out of a millimetre of noise.

    Args:
        names: of the points.

    Attributes:
        slipped: (points, 3) in m in G.
    """

    def __init__(self, names: tuple[str, ...]) -> None:
        self._names = names
        self.slipped = np.zeros((len(names), 3))
        self._weights, self._rest = _fit()
        self._frames: deque[np.ndarray] = deque(maxlen=2 * HALF)
        self._before = np.zeros((len(names), 3)), np.zeros(len(names)), np.zeros(len(names))  # as `_look` finds them

    def placed(self, points: np.ndarray, noise: float) -> np.ndarray:
        """Tracked points (points, 3) in m in G where they would be if none had slipped; NaN where missing.

        Args:
            points: as tracked.
            noise: of a coordinate, 1 sigma in m.
        """
        self._frames.append(points - self.slipped)
        if len(self._frames) == 2 * HALF:
            self._look(noise)
        return self._frames[-1]

    def _look(self, noise: float) -> None:
        """A jump is where it stands out most, one frame before now: its vector, its square over its variance, and what it leaves."""
        frames = np.array(self._frames)
        jumps = np.tensordot(self._weights, frames, 1)
        sizes = (jumps**2).sum(axis=1) / (noise**2 * (self._weights**2).sum())
        left = (np.tensordot(self._rest, frames, 1) ** 2).sum(axis=(0, 2)) / (3 * noise**2 * np.trace(self._rest))
        (jumped, before, unexplained), self._before = self._before, (jumps, sizes, left)
        which = int(np.argmax(np.nan_to_num(before)))
        others = np.delete(before, which)
        others = others[np.isfinite(others)]
        alone = len(others) > 0 and bool((others <= STILL).all())
        if not alone or before[which] <= max(JUMPED, sizes[which]) or not unexplained[which] <= LEFT:
            return
        if np.linalg.norm(jumped[which]) > FARTHEST:
            return
        self.slipped[which] += jumped[which]
        for frame in list(self._frames)[HALF - 1 :]:
            frame[which] -= jumped[which]
        self._before = np.zeros_like(jumps), np.zeros_like(sizes), np.zeros_like(left)

    def told(self) -> Mapping[str, str]:
        """A sentence for every point that slipped, by what it is about."""
        found = {}
        for name, off in zip(self._names, 1e3 * np.linalg.norm(self.slipped, axis=1), strict=True):
            if off > 0:
                found[f"marker {name}"] = (
                    f"tracked point {name} has jumped by {off:.1f} mm against the others: its marker slipped; the controller takes "
                    "that off until the run ends"
                )
        return found

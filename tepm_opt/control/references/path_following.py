"""Following a path on which progress is free: the controller's own clock goes slower where the tip is, or will be, off the path.

The path is timed as fast as actuators can follow (`control.timing`). What is left of model predictive contouring (Lam, Manzie, Good,
Model predictive contouring control, CDC 2010) is a governor: not the program decides how fast progress is, but a law from the errors that
the program foresees.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from tepm_opt.control.references.reference import Reference
from tepm_opt.control.references.time_optimal import DEFAULT, PaceSettings

FINE = 8  # rows of the path in a control period at full speed
WINDOW = 0.6  # s of the path about its target in which the nearest point of it is sought


@dataclass(eq=False)
class PathClock:
    """Progress along a path: rows at control periods so far, and the pace in force.

    Attributes:
        passed: rows at control periods as far as they are decided; grows.
        speed: part of the full speed, 0 … 1.
    """

    passed: list[float] = field(default_factory=lambda: [0.0])
    speed: float = 1.0


@dataclass(frozen=True, eq=False)
class PathFollowingReference(Reference):
    """A reference whose rows are `FINE` times denser than control periods, passed at a pace that the controller governs.

    Attributes:
        pace: settings of the governor.
        clock: progress of the one controller that follows it.
    """

    pace: PaceSettings = DEFAULT
    clock: PathClock = field(default_factory=PathClock)

    @property
    def step(self) -> float:
        """Time between rows at full speed in s."""
        return self.period / FINE

    @property
    def duration(self) -> float:
        """Time in s that has passed as far as rows are decided, and that the rest takes at full speed."""
        passed = self.clock.passed
        return self.period * (len(passed) - 1) + self.step * (len(self) - 1 - passed[-1])

    def rewind(self) -> PathFollowingReference:
        """Return the same path at its start, with a clock of its own."""
        return replace(self, clock=PathClock())

    def rows_at(self, periods: np.ndarray | int) -> np.ndarray:
        """Row numbers of periods, (…,): those decided, and from there on at the present pace."""
        periods, passed = np.maximum(periods, 0), self.clock.passed
        last = len(passed) - 1
        known = np.array(passed)[np.minimum(periods, last)]
        ahead = np.maximum(periods - last, 0) * FINE * self.clock.speed
        return np.clip(np.rint(known + ahead), 0, len(self) - 1).astype(int)

    def is_over(self, period: int) -> bool:
        """Whether the path was at its end a period before."""
        return period > 0 and bool(self.rows_at(period - 1) == len(self) - 1)

    def govern(self, period: int, errors: np.ndarray) -> None:
        """Decide on the rows up to a period, and on the pace after it.

        Args:
            period: up to which rows are used as they are.
            errors: distances of the tip from its targets over the coming stages in m.
        """
        pace, clock = self.pace, self.clock
        while len(clock.passed) <= period:
            clock.passed.append(min(clock.passed[-1] + FINE * clock.speed, float(len(self) - 1)))
        part = (float(errors.max()) - pace.small) / (pace.large - pace.small)
        wanted = 1.0 - (1.0 - pace.slowest) * float(np.clip(part, 0.0, 1.0))
        most = pace.change * self.period
        clock.speed += float(np.clip(wanted - clock.speed, -most, most))


def contour_errors(reference: Reference, rows: np.ndarray, tips: np.ndarray) -> np.ndarray:
    """Distances of tips (samples, 3) from the reference's path in m, (samples,), in pieces about the rows where each should be.

    Args:
        reference: whose path.
        rows: of the targets, (samples,).
        tips: in m in G.
    """
    reach, path = round(WINDOW / reference.step), reference.path
    found = np.empty(len(tips))
    for k, (row, tip) in enumerate(zip(rows, tips, strict=True)):
        piece = path[max(row - reach, 0) : row + reach + 1]
        start, way = piece[:-1], np.diff(piece, axis=0)
        part = np.clip(((tip - start) * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-18), 0.0, 1.0)
        found[k] = np.linalg.norm(start + part[:, None] * way - tip, axis=1).min() if len(way) else np.linalg.norm(piece[0] - tip)
    return found

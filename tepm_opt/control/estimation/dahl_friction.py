"""Direction in which dry friction pulls: that of the motion, turned over within a presliding distance (Dahl)."""

from __future__ import annotations

import numpy as np


def dahl_step(direction: np.ndarray, change: np.ndarray, distance: float | np.ndarray) -> np.ndarray:
    """Friction direction −1 … 1 after a change of length, (…,) each; change and distance in m.

    ds = dx / distance · (1 − s sgn dx), exactly for a motion one way. Dahl, A solid friction model, Aerospace Corp. TOR-158, 1968.
    """
    sign = np.sign(change)
    return np.where(change == 0, direction, sign + (direction - sign) * np.exp(-np.abs(change) / distance))


def dahl_sequence(direction: np.ndarray, changes: np.ndarray, distance: float) -> np.ndarray:
    """Directions −1 … 1 after each of successive changes in m, (changes, …), from a first direction (…,)."""
    kept = np.exp(-np.abs(changes) / distance)
    out = np.sign(changes) * (1 - kept)
    for k in range(len(out)):
        direction = out[k] = out[k] + kept[k] * direction
    return out

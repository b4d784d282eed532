"""How near a closed loop came to obstacles: columns of its log and numbers of its summary."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from tepm_opt.control.keep_out import DISTANCE, OBSTACLE, POINT, TRUE_DISTANCE
from tepm_opt.control.loop import LoopRecord
from tepm_opt.control.reference import Reference


def moved_most(reference: Reference) -> float:
    """How far at most the path was led out of obstacles' way, in m; NaN where there are none."""
    return math.nan if reference.moved is None else float(reference.moved.max())


def true_distance(done: LoopRecord, rows: slice) -> dict[str, np.ndarray]:
    """The column of the true least distance in m, (samples,), where there are obstacles."""
    return {} if done.reference.keep_out is None else {TRUE_DISTANCE: np.array(done.distance[rows], dtype=float)}


def smallest(steps: Mapping[str, np.ndarray]) -> float:
    """The true least distance of a run in m; infinite where there are no obstacles, or nothing is known."""
    values = steps.get(TRUE_DISTANCE, np.zeros(0))
    return float(np.nanmin(values)) if np.isfinite(values).any() else math.inf


def touched(steps: Mapping[str, np.ndarray], time: np.ndarray) -> dict[str, tuple[float, str]]:
    """The doubt that a person is told where the arm was inside an obstacle, with when it first was, in s.

    Args:
        steps: columns of the log.
        time: of their rows in s.
    """
    found: dict[str, tuple[float, str]] = {}
    for kind, name in (("as estimated", DISTANCE), ("in truth", TRUE_DISTANCE)):
        values = steps.get(name, np.zeros(0))
        inside = np.flatnonzero(values < 0)
        if len(inside):
            k = int(np.nanargmin(values))
            what = f" {steps[OBSTACLE][k]!s} (at {steps[POINT][k]!s})" if OBSTACLE in steps else " an obstacle"
            found[f"keep out, {kind}"] = float(time[inside[0]]), f"the arm was {-1e3 * values[k]:.2g} mm inside{what}, {kind}"
    return found


def clearance(steps: Mapping[str, np.ndarray], time: np.ndarray, moved: float) -> dict[str, Any] | None:
    """The least distances of a run in m, as estimated and in truth, when and between what; None where there are no obstacles.

    Args:
        steps: columns of the log.
        time: of their rows in s.
        moved: how far at most the path was led out of the way, in m.
    """
    if TRUE_DISTANCE not in steps or not len(time):
        return None
    found: dict[str, Any] = {"path_moved_by_m": moved}
    for kind, name in (("estimated", DISTANCE), ("true", TRUE_DISTANCE)):
        values = steps.get(name, np.full(len(time), np.nan))
        known = np.isfinite(values)
        k = int(np.nanargmin(values)) if known.any() else 0
        found[kind] = {"smallest_m": float(values[k]), "at_s": float(time[k])} if known.any() else None
        if kind == "estimated" and known.any():
            found[kind] |= {"obstacle": str(steps[OBSTACLE][k]), "point": str(steps[POINT][k])}
    return found

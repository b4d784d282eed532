"""Distances of a closed loop from obstacles and from a path with free progress: columns of its log, numbers of its summary."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from tepm_opt.control.collision.model import DISTANCE, OBSTACLE, POINT, TRUE_DISTANCE
from tepm_opt.control.loop import LoopRecord
from tepm_opt.control.references.path_following import PathFollowingReference, contour_errors
from tepm_opt.control.references.reference import Reference

CONTOUR, TRUE_CONTOUR = "contour_error_m", "true_contour_error_m"


def moved_most(reference: Reference) -> float:
    """Find the largest displacement of the path out of obstacles' way, in m; NaN where there are none."""
    return math.nan if reference.moved is None else float(reference.moved.max())


def true_distance(done: LoopRecord, rows: slice) -> dict[str, np.ndarray]:
    """The column of the true least distance in m, (samples,), where there are obstacles."""
    return {} if done.reference.keep_out is None else {TRUE_DISTANCE: np.array(done.distance[rows], dtype=float)}


def smallest(steps: Mapping[str, np.ndarray]) -> float:
    """The true least distance of a run in m; infinite where there are no obstacles, or nothing is known."""
    values = steps.get(TRUE_DISTANCE, np.zeros(0))
    return float(np.nanmin(values)) if np.isfinite(values).any() else math.inf


def find_contacts(steps: Mapping[str, np.ndarray], time: np.ndarray) -> dict[str, tuple[float, str]]:
    """Find where the arm was inside an obstacle: the doubt that a person is told, with when it first was, in s.

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


def contour_columns(done: LoopRecord, rows: slice) -> dict[str, np.ndarray]:
    """Columns of distances from the path in m, of the tracked and the true tip, (samples,), where progress is free."""
    if not isinstance(done.reference, PathFollowingReference):
        return {}
    places, points = np.array(done.rows[rows], dtype=int), np.array(done.points[rows])
    tips = {CONTOUR: points[:, -1] if len(points) else np.zeros((0, 3)), TRUE_CONTOUR: np.array(done.truth[rows]).reshape(-1, 3)}
    return {name: contour_errors(done.reference, places, each) for name, each in tips.items()}


def contour(steps: Mapping[str, np.ndarray], counted: np.ndarray) -> dict[str, Any] | None:
    """Contour errors where they count, root mean square and largest in m, true and tracked; None where progress is not free."""
    if CONTOUR not in steps:
        return None
    found: dict[str, Any] = {}
    for kind, name in (("true", TRUE_CONTOUR), ("tracked", CONTOUR)):
        known = steps[name][counted]
        known = known[np.isfinite(known)]
        found[kind] = {"rms_m": float(np.sqrt((known**2).mean())), "largest_m": float(known.max())} if len(known) else None
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

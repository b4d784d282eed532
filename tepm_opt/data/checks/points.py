"""Checks of the reference points that hold for motions and for equilibria: missing, misplaced, in another unit, interchanged."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, pairwise, permutations

import numpy as np

from tepm_opt.data.checks.findings import Finding, Subject, longest
from tepm_opt.data.sizes import LARGE, LENGTHS, tell_places


def check_points(subject: Subject) -> Iterator[Finding]:
    """Sensors without samples, dropouts, codes for a missing sample, wrong units, points not in order along the robot."""
    points, names = subject.run.points, subject.channels.points
    for k, name in enumerate(names):
        yield from _check_dropouts(subject, name, points[:, k])
        yield from _codes(subject, name, points[:, k])
    if misplaced := list(wrong_units(subject)):
        yield from misplaced
        return
    yield from _places(subject)
    yield from _order(subject)


def _check_dropouts(subject: Subject, name: str, point: np.ndarray) -> Iterator[Finding]:
    lost = ~np.isfinite(point)
    gone = np.asarray(lost.all(axis=1))
    if gone.all():
        others = np.isfinite(subject.points).any()  # they can still be used
        yield subject.make_finding("warning" if others else "error", name, "no sample in the whole run")
        return
    if (rows := np.flatnonzero(lost.any(axis=1) & ~gone)).size:
        yield subject.make_finding("warning", name, "part of the position is missing", rows)
    if not gone.any():
        return
    share, (length, first, last) = 100 * gone.mean(), longest(gone)
    gap = f"{length} rows ({length * subject.step:.3g} s)" if subject.step else f"{length} rows"
    message = f"dropouts: {share:.2g} % of the samples are missing, the longest gap {gap}, lines {subject.run.line(first)} to "
    message += f"{subject.run.line(last)}"
    yield subject.make_finding("warning", name, message, np.flatnonzero(gone))


def _codes(subject: Subject, name: str, point: np.ndarray) -> Iterator[Finding]:
    zero = np.all(point == 0, axis=1)
    if zero.sum() > 1 and not zero.all():
        yield subject.make_finding(
            "error", name, "all coordinates are 0, a code for a lost sample? Leave such fields empty", np.flatnonzero(zero)
        )
    if zero.all() and len(zero) > 1:
        yield subject.make_finding("error", name, "all coordinates are 0 in the whole run")


def _distances(subject: Subject) -> np.ndarray:
    """Typical distance of each point from the base over what it is at rest, (points,); NaN where unknown."""
    channels, points = subject.channels, subject.points
    height = channels.height
    seen = [point[np.isfinite(point).all(axis=1)] for point in np.moveaxis(points, 1, 0)]
    found = [np.median(np.linalg.norm(point - channels.base, axis=1)) if len(point) else np.nan for point in seen]
    count = len(channels.points)
    return np.array(found) / (height * np.arange(1, count + 1) / count if height else np.full(count, np.nan))


def wrong_units(subject: Subject) -> Iterator[Finding]:
    """Findings where positions are so large or small for the robot that their unit must be wrong."""
    channels = subject.channels
    ratios = _distances(subject)
    if channels.height is None:
        with np.errstate(invalid="ignore"):
            ratios = np.nan_to_num(np.nanmax(np.abs(subject.points), axis=(0, 2), initial=0.0) / 10)
    for name, ratio in zip(channels.points, ratios, strict=True):
        if ratio > LARGE:
            factor = min(LENGTHS, key=lambda unit: _mismatch(subject, unit))
            yield subject.make_finding("error", name, tell_places(ratio, LENGTHS[factor]))
        elif channels.height is not None and ratio < 0.02:
            yield subject.make_finding("error", name, f"positions are {ratio:.3g} times what the robot's size lets expect: in km, not m?")


def _mismatch(subject: Subject, factor: float) -> float:
    """Compare the points' distances with those that the robot's size lets expect, if a metre is written as `factor`; on a log scale."""
    run = replace(subject.run, points=subject.run.points / factor)
    ratios = _distances(Subject(run, subject.channels, subject.rate))
    known = ratios[np.isfinite(ratios) & (ratios > 0)]
    return float(np.median(np.abs(np.log(known)))) if known.size else abs(np.log(factor / 1e3))


def _places(subject: Subject) -> Iterator[Finding]:
    """Points too near or too far from the base, or a robot that starts on its side: another frame than G, or another robot."""
    channels = subject.channels
    for name, ratio in zip(channels.points, _distances(subject), strict=True):
        if ratio > 1.7 or ratio < 0.4:
            message = f"typically {ratio:.2f} times as far from the base as at rest: are positions in G and is the robot file right?"
            yield subject.make_finding("warning", name, message)
    if channels.height is None or not channels.points:
        return
    start = subject.points[: min(subject.run.rows, 50), 0]
    start = start[np.isfinite(start).all(axis=1)]
    if len(start):
        direction = np.median(start, axis=0) - channels.base
        if direction @ channels.axis < np.cos(np.deg2rad(50)) * np.linalg.norm(direction):
            yield subject.make_finding(
                "error", channels.points[0], "not above the base at the start: axes interchanged, or another frame than G?", is_setup=True
            )


def _order(subject: Subject) -> Iterator[Finding]:
    channels = subject.channels
    chain = subject.points
    if channels.height is not None:
        chain = np.concatenate([np.broadcast_to(channels.base, (subject.run.rows, 1, 3)), chain], axis=1)
    first, count = chain.shape[1] - len(channels.points), chain.shape[1]
    between = np.zeros((count, count))
    for a, b in combinations(range(count), 2):
        distance = np.linalg.norm(chain[:, a] - chain[:, b], axis=1)
        distance = distance[np.isfinite(distance)]
        if not len(distance):
            return
        between[a, b] = between[b, a] = np.median(distance)
    order = tuple(range(count))
    lengths = {other: _length(between, other) for other in _orders(first, count)}
    best = min(lengths, key=lengths.__getitem__)
    if best != order and lengths[best] < _length(between, order) - 0.3 * _length(between, best) / max(count - 1, 1):
        names = channels.points
        wrong = [names[k - first] for k in order[first:] if best[k] != k]
        lie = ", ".join(names[k - first] for k in best[first:])
        message = f"{' and '.join(wrong)} interchanged? Along the robot the points lie in the order {lie}"
        yield subject.make_finding("error", " ".join(wrong), message, is_setup=True)


def _length(between: np.ndarray, order: tuple[int, ...]) -> float:
    return float(sum(between[a, b] for a, b in pairwise(order)))


def _orders(first: int, count: int) -> Iterator[tuple[int, ...]]:
    """Orders of the chain that keep what comes before `first`: all of them, or with many points those with two interchanged."""
    start, points = tuple(range(first)), tuple(range(first, count))
    if len(points) <= 6:
        # without a base, an order and its reverse are equally long: keep those that run upwards
        yield from (start + order for order in permutations(points) if first or not order or order[0] <= order[-1])
        return
    for a, b in combinations(points, 2):
        order = list(start + points)
        order[a], order[b] = order[b], order[a]
        yield tuple(order)

"""Numbers that stand for lost samples: far outside what a column holds, and the same in many rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

FEWEST = 2  # rows with the same three numbers of a point; of one column one more
FAR = 3.0  # times the range of the other samples beyond them: no noise and no motion leaves such a gap, and returns to one number
NEAR_KNOWN = 0.5  # the same for the numbers that programs write on purpose
ABSURD = 1e15  # no sensor's number in any unit
MOST = 8  # codes and strays that are looked at
DISTINCT = 5  # other values: below these a column switches rather than measures
KNOWN = (
    *(sign * each for each in (99.0, 999.0, 9999.0, 99999.0, 999999.0, 1e6, 1e9, 999.9, 9999.9) for sign in (1, -1)),
    *(-32768.0, 32767.0, 65535.0, -2147483648.0, 2147483647.0, 4294967295.0),
)


def far_codes(values: np.ndarray, fewest: int = FEWEST + 1) -> list[float]:
    """Numbers of a column that stand for lost samples; zero only where it comes and goes.

    Args:
        values: (rows,), NaN where samples are missing.
        fewest: rows that hold a number before it is taken for a code.
    """
    numbers, counts = np.unique(values[np.isfinite(values)], return_counts=True)
    found: list[float] = []
    for _ in range(MOST):
        for end in (0, -1):
            if len(numbers) < 2 or not _is_code(number := float(numbers[end]), np.delete(numbers, end)):
                continue
            if (counts[end] >= fewest and (number != 0 or _comes_and_goes(values == 0))) or abs(number) >= ABSURD:
                found.append(number)  # else a single stray
            numbers, counts = np.delete(numbers, end), np.delete(counts, end)
            break
        else:
            break
    return found


def _is_code(number: float, rest: np.ndarray) -> bool:
    """Whether a number lies far outside all others of its column."""
    if abs(number) >= ABSURD:
        return bool(rest.size) and float(np.abs(rest).max()) < 1e-6 * abs(number)
    if len(rest) < DISTINCT:
        return False
    gap = float(np.abs(rest - number).min())
    outside = number > rest[-1] or number < rest[0]
    return outside and gap > (NEAR_KNOWN if number in KNOWN else FAR) * float(rest[-1] - rest[0])


def _comes_and_goes(where: np.ndarray) -> bool:
    """Whether rows with others before and behind are among those."""
    rows = np.flatnonzero(where)
    return bool(rows.size) and bool(np.any(~where[: rows[-1]]) and np.any(~where[rows[0] :]))


def lost_points(points: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """Rows of each point that hold the same three numbers far outside all others, and these numbers.

    Args:
        points: (points, 3, rows).

    Returns:
        (points, rows), true where a code stands; the numbers, largest first.
    """
    lost = np.zeros((points.shape[0], points.shape[2]), dtype=bool)
    found: list[float] = []
    for k, point in enumerate(points):
        codes = [set(far_codes(axis, FEWEST)) - {0.0} for axis in point]
        if not all(codes):
            continue
        lost[k] = np.all([np.isin(axis, list(each)) for axis, each in zip(point, codes, strict=True)], axis=0)
        found += [float(value) for value in np.unique(point[:, lost[k]])]
    return lost, sorted(dict.fromkeys(found), key=lambda value: -abs(value))


def as_written(number: float) -> float | int:
    """A number as people write it: -9999, not -9999.0."""
    return int(number) if number == int(number) and abs(number) < ABSURD else number


def words_of(numbers: Sequence[float]) -> str:
    """Numbers for people: "-9999 and -3.697314e+28"."""
    return " and ".join(f"{number:.10g}" for number in numbers)

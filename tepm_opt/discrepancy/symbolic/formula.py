"""The shortest formula that predicts left-out runs as well as the best one does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from tepm_opt.discrepancy.symbolic.curves import Lags, Plays, Powers
from tepm_opt.discrepancy.symbolic.places import Course, Place
from tepm_opt.discrepancy.symbolic.responses import Normal, normals
from tepm_opt.discrepancy.symbolic.score import left_out, prior_of, solved
from tepm_opt.discrepancy.symbolic.terms import Terms, library
from tepm_opt.models.layout import Layout
from tepm_opt.solvers.identify import ParameterEstimate

MOST_TERMS = 4
PAIRED = 90  # columns up to which all pairs are tried
FOLLOWED = 5  # sets of terms that grow at the same time
MATERIAL = 0.02  # of the structure left, which one more term has to take away
TINY = 1e-9  # precision of coefficients over what the runs tell
TIMES = tuple(float(t) for t in np.geomspace(0.02, 8.0, 14).round(3))  # s
WIDTHS = tuple(float(w) for w in np.geomspace(0.004, 0.4, 14).round(4))  # of the visited range


@dataclass(frozen=True, eq=False)
class Formula:
    """A place with the few coefficients that its law needs.

    Attributes:
        place: where; its shape has all terms that were tried.
        chosen: numbers of the coefficients that count.
        coefficients, std: of these, in the law's unit, (chosen,) each.
        closes: part of the structure left that it predicts in left-out data, to first order.
        complete: the same of the best formula of any length.
    """

    place: Place
    chosen: tuple[int, ...]
    coefficients: np.ndarray
    std: np.ndarray
    closes: float
    complete: float

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Formula({self.place.label}, {len(self.chosen)} of {self.place.size} terms, closes {self.closes:.4f})"


def with_terms(place: Place, made: Sequence[Course], layout: Layout, length: float) -> Place:
    """A place with all terms that its formula may have, in the shape's place.

    Args:
        place: where.
        made: the runs.
        layout: of the robot.
        length: of a muscle at rest in m.
    """
    values = np.concatenate([course.of(place.variable, layout).reshape(course.run.rows, -1) for course in made])
    reach = float(np.ptp(values))
    if place.memory == "late":
        return replace(place, shape=Lags(TIMES, reach))
    if place.memory == "remembered":
        return replace(place, shape=Plays(tuple(w * reach for w in WIDTHS), reach))
    if place.kind == "measurement" or place.variable == "speed":
        return place
    if place.kind == "axial" and place.variable != "time":
        values = values[:, place.targets(layout)]
    origin = length if place.variable == "length" else 0.0
    shape = library(values[:, -3:] if place.kind == "force" else values, origin, place.variable == "time")
    return replace(place, shape=shape)


def compress(estimate: ParameterEstimate, made: Sequence[Course], place: Place) -> Formula:
    """The shortest formula at a place, to first order.

    Sets of terms grow from the best single one and the best pairs; the shortest is taken that predicts left-out runs as well as the best
    does, within a standard error of the difference (Breiman et al., Classification and Regression Trees, 1984, section 3.4.3) or within
    what is not material.

    Args:
        estimate: what was fitted.
        made: the runs as its model does them.
        place: with all terms, see `with_terms`.
    """
    (runs,) = normals(estimate.problem, estimate.residuals, made, [place])
    precision, pull = prior_of(estimate.problem, estimate.values)
    free = len(precision)
    total = np.asarray(sum(run.square.sum(axis=0) for run in runs))
    weights = TINY * np.maximum(np.diag(total)[free:], 1e-300)

    def errors(chosen: Sequence[int]) -> np.ndarray:
        kept = [*range(free), *(free + k for k in chosen)]
        return left_out([_only(run, kept) for run in runs], precision, pull, np.diag(weights[list(chosen)]))[0]

    base, count = errors(()), sum(int(run.counts.sum()) for run in runs)
    structure = max(float(base.sum()) - count, 3 * np.sqrt(2 * count))
    best: list[tuple[tuple[int, ...], np.ndarray]] = [((), base)]
    front: list[tuple[int, ...]] = [()]
    for size in range(1, MOST_TERMS + 1):
        grown = {tuple(sorted((*each, k))) for each in front for k in range(place.size) if k not in each}
        if size == 2 and place.size <= PAIRED:
            grown = set(combinations(range(place.size), 2))
        scored = sorted(((errors(each), each) for each in sorted(grown)), key=lambda pair: float(pair[0].sum()))
        if not scored:
            break
        front = [each for _, each in scored[:FOLLOWED]]
        best.append((front[0], scored[0][0]))
    winner, least = min(best, key=lambda pair: float(pair[1].sum()))
    for chosen, left in best:
        difference = left - least
        error = float(np.sqrt(len(difference)) * difference.std())
        if chosen == winner or (chosen and difference.sum() <= max(error, MATERIAL * structure)):
            winner, kept_errors = chosen, left
            break
    else:
        kept_errors = least
    kept = [*range(free), *(free + k for k in winner)]
    known = np.diag(np.concatenate([precision, weights[list(winner)]]))
    slope = np.asarray(sum(run.slope.sum(axis=0) for run in runs))[kept]
    slope[:free] += pull
    matrix = total[np.ix_(kept, kept)] + known
    step = -solved(matrix, slope)
    spread = max(float(kept_errors.sum()) / max(count, 1), 1.0)
    std = np.sqrt(spread * np.diag(np.linalg.pinv(matrix, hermitian=True)))
    closes, complete = (float((base.sum() - each.sum()) / structure) for each in (kept_errors, least))
    return Formula(place, winner, step[free:], std[free:], closes, complete)


def _only(normal: Normal, kept: Sequence[int]) -> Normal:
    at = np.array(kept, dtype=int)
    return Normal(normal.square[:, at[:, None], at], normal.slope[:, at], normal.squares, normal.counts)


def named(place: Place, number: int) -> str:
    """What a coefficient stands for: "quadratic", "ramp", "lag", "play", "x: linear"."""
    axis, shape = "", place.shape
    if place.kind != "axial" and place.variable in ("position", "time"):
        axis, number = f"{'xyz'[number // shape.size]}: ", number % shape.size
    if isinstance(shape, Terms):
        return axis + shape.terms[number].kind
    if isinstance(shape, Powers) and shape.centre:
        return axis + ("".join("xyz"[e] for e in shape.exponents[number]) or "constant")
    if place.variable == "speed":
        return ("dry", "linear", "quadratic")[number]
    return axis + {"late": "lag", "remembered": "play"}.get(place.memory, f"{number}")

"""Formulas: the fewest terms that predict left-out runs as well as the best set of them does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from tepm_opt.discrepancy.symbolic.curves import Lags, Plays, Powers
from tepm_opt.discrepancy.symbolic.places import Course, Place
from tepm_opt.discrepancy.symbolic.responses import Normal, normal_equations_by_place
from tepm_opt.discrepancy.symbolic.score import left_out_errors, prior_of, solve_scaled
from tepm_opt.discrepancy.symbolic.settings import DEFAULT, SymbolicSettings
from tepm_opt.discrepancy.symbolic.terms import Terms, terms_over
from tepm_opt.solvers.identification.identify import ParameterEstimate


@dataclass(frozen=True, eq=False)
class Formula:
    """A law of few terms.

    Attributes:
        place: of the law; its shape has all terms that were tried.
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


def with_terms(place: Place, made: Sequence[Course], length: float, settings: SymbolicSettings = DEFAULT) -> Place:
    """A place with all terms that its formula may have, instead of its shape.

    Args:
        place: of a smooth law.
        made: the runs.
        length: of a muscle at rest in m.
        settings: of the search.
    """
    values = np.concatenate([course.values_of(place.variable).reshape(course.run.rows, -1) for course in made])
    reach = float(np.ptp(values))
    if place.memory == "late":
        return replace(place, shape=Lags(settings.formula_lag_times, reach))
    if place.memory == "remembered":
        return replace(place, shape=Plays(tuple(width * reach for width in settings.formula_play_widths), reach))
    if place.kind == "measurement" or place.variable == "speed":
        return place
    if place.kind == "axial" and place.variable != "time":
        values = values[:, place.targets(made[0].model.layout)]
    origin = length if place.variable == "length" else 0.0
    return replace(place, shape=terms_over(values[:, -3:] if place.kind == "force" else values, origin, place.variable == "time"))


def compress(estimate: ParameterEstimate, made: Sequence[Course], place: Place, settings: SymbolicSettings = DEFAULT) -> Formula:
    """The shortest formula at a place, to first order.

    The shortest set of terms is taken that predicts left-out runs as well as the best does, within a standard error of the difference
    (Breiman et al., Classification and Regression Trees, 1984, section 3.4.3) or within `material_share`.

    Args:
        estimate: the fit whose residuals are explained.
        made: its runs as its model does them.
        place: with all terms, see `with_terms`.
        settings: of the search.
    """
    (runs,) = normal_equations_by_place(estimate, made, [place], settings)
    precision, pull = prior_of(estimate.problem, estimate.values)
    free = len(precision)
    total = np.asarray(sum(run.square.sum(axis=0) for run in runs))
    weights = 1e-9 * np.maximum(np.diag(total)[free:], 1e-300)  # a prior so wide that it only keeps the equations regular

    def errors(chosen: tuple[int, ...]) -> np.ndarray:
        kept = [*range(free), *(free + k for k in chosen)]
        return left_out_errors([_select(run, kept) for run in runs], precision, pull, np.diag(weights[list(chosen)]))[0]

    best = _grow(errors, place.size, settings)
    base, count = best[0][1], sum(int(run.counts.sum()) for run in runs)
    structure = max(float(base.sum()) - count, 3 * np.sqrt(2 * count))
    winner, least = min(best, key=lambda pair: float(pair[1].sum()))
    kept_errors = least
    for chosen, left in best:
        difference = left - least
        error = float(np.sqrt(len(difference)) * difference.std())
        if chosen == winner or (chosen and difference.sum() <= max(error, settings.material_share * structure)):
            winner, kept_errors = chosen, left
            break
    kept = [*range(free), *(free + k for k in winner)]
    slope = np.asarray(sum(run.slope.sum(axis=0) for run in runs))[kept]
    slope[:free] += pull
    matrix = total[np.ix_(kept, kept)] + np.diag(np.concatenate([precision, weights[list(winner)]]))
    step = -solve_scaled(matrix, slope)
    spread = max(float(kept_errors.sum()) / max(count, 1), 1.0)
    std = np.sqrt(spread * np.diag(np.linalg.pinv(matrix, hermitian=True)))
    closes, complete = (float((base.sum() - each.sum()) / structure) for each in (kept_errors, least))
    return Formula(place, winner, step[free:], std[free:], closes, complete)


def _grow(
    errors: Callable[[tuple[int, ...]], np.ndarray], size: int, settings: SymbolicSettings
) -> list[tuple[tuple[int, ...], np.ndarray]]:
    """The best set of terms of each length from 0 on, with its errors; sets grow from the best single terms and pairs of `size`."""
    best: list[tuple[tuple[int, ...], np.ndarray]] = [((), errors(()))]
    front: list[tuple[int, ...]] = [()]
    for count in range(1, settings.most_terms + 1):
        grown = {tuple(sorted((*each, k))) for each in front for k in range(size) if k not in each}
        if count == 2 and size <= settings.most_paired:
            grown = set(combinations(range(size), 2))
        scored = sorted(((errors(each), each) for each in sorted(grown)), key=lambda pair: float(pair[0].sum()))
        if not scored:
            break
        front = [each for _, each in scored[: settings.beam_width]]
        best.append((front[0], scored[0][0]))
    return best


def _select(normal: Normal, kept: Sequence[int]) -> Normal:
    """Normal equations of some columns."""
    at = np.array(kept, dtype=int)
    return Normal(normal.square[:, at[:, None], at], normal.slope[:, at], normal.squares, normal.counts)


def name_term(place: Place, number: int) -> str:
    """Name of a coefficient: "quadratic", "ramp", "lag", "play", "x: linear"."""
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

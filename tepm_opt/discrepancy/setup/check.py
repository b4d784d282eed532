"""The check for set-up errors: which mend, if any, explains most of the misfit of the nominal model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tepm_opt.data.run import Run, thin_out
from tepm_opt.discrepancy.problem.plant import SearchablePlant
from tepm_opt.discrepancy.setup.comparison import Comparison, Misfit, take_rows
from tepm_opt.discrepancy.setup.errors import SetupError
from tepm_opt.discrepancy.setup.hypotheses import (
    ATMOSPHERE,
    SetupHypothesis,
    force_hypotheses,
    input_hypotheses,
    point_hypotheses,
)
from tepm_opt.discrepancy.setup.settings import DEFAULT, SetupSettings
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.identification.identify import ParameterEstimate, Problem, identify
from tepm_opt.solvers.identification.initial_state import first
from tepm_opt.solvers.mechanics.plant import PredictionError


def find_setup_errors(
    plant: SearchablePlant,
    runs: Sequence[Run],
    noise: float | np.ndarray,
    progress: Progress = silent,
    settings: SetupSettings = DEFAULT,
    spreads: Mapping[str, float] | None = None,
) -> tuple[tuple[SetupError, ...], tuple[Run, ...]]:
    """Set-up errors, likelier ones of each mistake first, and the mended runs.

    One mistake is looked for after the other: with the first one mended a second one shows.

    Args:
        plant: the nominal model.
        runs: as recorded.
        noise: of the measurements, 1 sigma per axis, or of each point, (points, 1).
        progress: told of the work.
        settings: thresholds.
        spreads: standard deviations of known parameters by full name, where more is known of them than the plant says.
    """
    found: list[SetupError] = []
    progress("checking the set-up: wiring, axes, units, markers", 0, 0)
    compared = _choose_rows(plant, runs, settings)
    if not any(np.isfinite(run.points).any() for run in compared):
        return (), tuple(runs)
    try:
        comparison = Comparison.simulate(plant, compared, noise, settings, spreads)
        for _ in range(settings.max_errors):
            ranked = _rank_hypotheses(comparison, plant)
            if not ranked:
                break
            misfit, best = ranked[0]
            if not _is_explained(comparison, misfit, best):
                refitted = _refit_known_parameters(comparison, plant, ranked)
                if refitted is None:
                    break
                comparison, ranked = refitted
                misfit, best = ranked[0]
                plant = plant.with_values(comparison.plant.values)
            mended, compared = ([comparison.within_limits(best.apply(run)) for run in each] for each in (runs, comparison.runs))
            after = Comparison.simulate(plant, compared, noise, settings, spreads)
            late = comparison.least_on_another_clock()
            if late <= misfit.mean_square and after.least_on_another_clock() > settings.max_left_by_clock * late:
                break  # a clock explains as much, and with it the mend explains little
            some = _share_probability(ranked, comparison)
            found += [replace(some[0], is_mended=True), *some[1:]]
            runs, comparison = mended, after
    except PredictionError:  # the search says so
        pass
    return tuple(found), tuple(runs)


def _choose_rows(plant: SearchablePlant, runs: Sequence[Run], settings: SetupSettings) -> list[Run]:
    """Runs to compare: thinned motions of a network, some equilibria, beginnings of the fit runs of a plant simulated in full."""
    if plant.without_candidates.static:
        return [take_rows(run, np.unique(np.linspace(0, run.rows - 1, min(run.rows, settings.rows)).round().astype(int))) for run in runs]
    if plant.equilibria is not None:
        return [thin_out(run, settings.sample_spacing) for run in runs]
    return [first(run, settings.first_rows) for run in runs if run.role == "fit"]


def _rank_hypotheses(comparison: Comparison, plant: SearchablePlant) -> list[tuple[Misfit, SetupHypothesis]]:
    """Hypotheses that leave less than there is, simulated in full, the one that leaves least first."""
    forces = force_hypotheses() if any(np.abs(run.tip_force).max(initial=0.0) > 0 for run in comparison.runs) else ()
    points = point_hypotheses(plant.signals, comparison.thinned, comparison.points)
    screened = comparison.screen([*input_hypotheses(plant.signals), *forces, *points])
    confirmed = [hypothesis for left, hypothesis in screened if left < 1][: comparison.settings.confirmed]
    misfits = [(misfit, h) for h in confirmed if (misfit := comparison.misfit_with(h)) is not None]
    return sorted(misfits, key=lambda each: each[0].mean_square)


def _refit_known_parameters(
    comparison: Comparison, plant: SearchablePlant, ranked: Sequence[tuple[Misfit, SetupHypothesis]]
) -> tuple[Comparison, list[tuple[Misfit, SetupHypothesis]]] | None:
    """The comparison with known parameters fitted to the mended runs, and the mend, where it explains them; None otherwise.

    Of a plant that is simulated quickly: what its guessed values miss, as the frequency of a swing, may exceed what a mend explains. As
    recorded, the runs have to be fitted far worse.

    Args:
        comparison: with the guessed values.
        plant: the nominal model.
        ranked: hypotheses, the one that leaves least first.
    """
    settings, plain = comparison.settings, plant.without_candidates
    if not plain.quick or plain.static:
        return None

    def fit(runs: Sequence[Run]) -> ParameterEstimate:
        problem = Problem(plain, tuple(runs), plain.free(plant.known), comparison.noise)
        return identify(problem, settings.refit_steps)

    recorded = fit(comparison.runs)
    if recorded.cost / recorded.count <= settings.max_unexplained * comparison.motion_mean_square:
        return None  # other values explain the runs as well as any mend has to
    fits = [(fit([comparison.within_limits(h.apply(run)) for run in comparison.runs]), h) for _, h in ranked[: settings.refitted]]
    mended, best = min(fits, key=lambda each: each[0].cost)
    if mended.cost > settings.max_refit_left * recorded.cost:
        return None
    after = Comparison.simulate(plant.with_values(mended.named), comparison.runs, comparison.noise, settings)
    misfit = after.misfit_with(best)
    if misfit is None or not _is_explained(after, misfit, best):
        return None
    return after, [(misfit, best)]


def _rests_at_atmosphere(hypothesis: SetupHypothesis, runs: Sequence[Run]) -> bool:
    """Whether the pressures of a hypothesis never fall far below the atmosphere's, and come near it."""
    lowest = np.min([run.inputs[:, list(hypothesis.columns)].min(axis=0) for run in runs], axis=0)
    return bool(np.all(lowest > 0.9 * ATMOSPHERE) and lowest.min() < 1.1 * ATMOSPHERE)


def _is_explained(comparison: Comparison, after: Misfit, hypothesis: SetupHypothesis) -> bool:
    """Whether a mend removes visibly more than it spoils, in all of the data, about as much as it says, and explains the motion."""
    before, settings = comparison.misfit(), comparison.settings
    size, doubt = before.coefficient(after)
    expected = hypothesis.kind == "absolute_pressure" and _rests_at_atmosphere(hypothesis, comparison.runs)
    close = settings.max_distance_smaller if hypothesis.shrinks(comparison.runs) else settings.max_distance
    is_visible = before.mean_square - after.mean_square >= settings.min_removed
    most = min(settings.max_unexplained * comparison.motion_mean_square, settings.max_left * before.mean_square)
    is_motion = after.mean_square <= most  # else of another machine, invented, or the model's own error
    return is_motion and is_visible and abs(size - 1) <= close and size - 0.5 >= (0.0 if expected else settings.min_sigma * doubt)


def _share_probability(ranked: Sequence[tuple[Misfit, SetupHypothesis]], comparison: Comparison) -> list[SetupError]:
    """Errors with their probabilities; of each kind and place the best mend, with the odds of all of these."""
    before, settings, least = comparison.misfit(), comparison.settings, ranked[0][0].mean_square
    odds = np.array([(misfit.mean_square / least) ** (-settings.worth / 2) for misfit, _ in ranked])
    alike: dict[tuple[str, tuple[str, ...]], SetupError] = {}
    for p, (misfit, h) in zip(odds / odds.sum(), ranked, strict=True):
        left = misfit.mean_square / before.mean_square
        first = alike.setdefault((h.kind, h.channels), SetupError(h.kind, h.channels, h.mend, 0.0, left, h))
        alike[h.kind, h.channels] = replace(first, probability=first.probability + float(p))
    return [error for error in alike.values() if error.probability >= settings.min_listed]

"""The check for set-up errors: which mend, if any, explains most of the misfit of the nominal model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.problem.plant import SearchablePlant
from tepm_opt.discrepancy.setup.comparison import Comparison
from tepm_opt.discrepancy.setup.hypotheses import SetupError, force_hypotheses, input_hypotheses, point_hypotheses
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.plant import PredictionError

MATERIAL = 0.9  # part of the misfit, nuisances fitted, that a mend may leave to be told
CONFIRMED = 5  # hypotheses that are simulated in full after the screening
WORTH = 60.0  # independent samples that the compared ones are worth: neighbours say nearly the same
LISTED = 0.1  # probability from which an alternative is told
MOST = 3  # set-up errors found one after the other


def find_setup_errors(
    plant: SearchablePlant, runs: Sequence[Run], noise: float | np.ndarray, progress: Progress = silent
) -> tuple[tuple[SetupError, ...], tuple[Run, ...]]:
    """Set-up errors, likelier ones of each mistake first, and the mended runs.

    One mistake is looked for after the other: with the first one mended a second one shows.

    Args:
        plant: the nominal model.
        runs: as recorded.
        noise: of the measurements, 1 sigma per axis, or of each point, (points, 1).
        progress: told of the work.
    """
    found: list[SetupError] = []
    runs = tuple(runs)
    for _ in range(MOST):
        progress("checking the set-up: wiring, axes, units, markers", 0, 0)
        try:
            some = _likeliest(Comparison.of(plant, runs, noise), plant)
        except PredictionError:  # the search says so
            break
        mend = some[0].hypothesis if some else None
        if mend is None:
            break
        found += some
        runs = tuple(mend.apply(run) for run in runs)
    return tuple(found), runs


def _likeliest(comparison: Comparison, plant: SearchablePlant) -> list[SetupError]:
    """The mistake that explains most of the misfit, with what cannot be told from it; empty where none is material."""
    signals, there = plant.signals, comparison.squares_left()
    forces = force_hypotheses() if any(np.abs(run.tip_force).max(initial=0.0) > 0 for run in comparison.runs) else ()
    hypotheses = [
        *input_hypotheses(signals),
        *forces,
        *point_hypotheses(signals, comparison.thinned, comparison.points),
    ]
    screened = [hypothesis for left, hypothesis in comparison.screen(hypotheses) if left < 1][:CONFIRMED]
    weighed = sorted(((comparison.squares_left(h), h) for h in screened), key=lambda each: each[0])
    if not weighed or weighed[0][0] > MATERIAL * there or there - weighed[0][0] < 0.1:
        return []
    odds = np.array([(left / weighed[0][0]) ** (-WORTH / 2) for left, _ in weighed])
    odds /= odds.sum()
    alike: dict[tuple[str, tuple[str, ...]], SetupError] = {}  # the best mend of each kind and place, with the odds of all of these
    for p, (left, h) in zip(odds, weighed, strict=True):
        first = alike.setdefault((h.kind, h.channels), SetupError(h.kind, h.channels, h.mend, 0.0, left / there, h))
        alike[h.kind, h.channels] = replace(first, probability=first.probability + float(p))
    return [error for error in alike.values() if error.probability >= LISTED]

"""Subsets of runs in which an effect may act that does not act in all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.linearised import Linearised
from tepm_opt.solvers.identification.identify import ParameterEstimate


def list_run_spans(files: Sequence[str]) -> list[tuple[str, ...]]:
    """Spans of runs, fewer than all: from one run on, until one, one alone."""
    count = len(files)
    spans = {(first, count) for first in range(1, count)} | {(0, end) for end in range(1, count)} | {(k, k + 1) for k in range(count)}
    return [tuple(files[first:end]) for first, end in sorted(spans) if end - first < count]


def select_longest_span(linear: Linearised, sets: Sequence[tuple[Candidate, ...]], settings: SearchSettings) -> tuple[Candidate, ...]:
    """The set whose last effect acts in most runs, of those that promise most but for `run_choice_slack`.

    In a run that does not show an effect it may act, too.
    """
    gains = [linear.gain(effects)[0] for effects in sets]
    most = max(gains)
    return max(
        zip(sets, gains, strict=True),
        key=lambda pair: ((most - pair[1]) * linear.excess <= settings.run_choice_slack, len(pair[0][-1].runs)),
    )[0]


def list_helped_runs(without: ParameterEstimate, with_effect: ParameterEstimate) -> tuple[str, ...]:
    """Files of the runs that an effect brings nearer to the data; none where these are all or do not stand out without it.

    A run in which an effect does not act is fitted worse with it.

    Args:
        without: fit without the effect.
        with_effect: fit with it in all runs.
    """
    count = np.maximum([r.count for r in without.residuals], 1)
    before = np.array([r.squares for r in without.residuals]) / count
    after = np.array([r.squares for r in with_effect.residuals]) / count
    helped = after < before
    if helped.all() or not helped.any() or before[helped].min() <= before[~helped].max():
        return ()
    return tuple(r.file for r, helps in zip(without.residuals, helped, strict=True) if helps)

"""Subsets of runs in which an effect may act that does not act in all."""

from __future__ import annotations

from collections.abc import Sequence

from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.linearised import Linearised


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

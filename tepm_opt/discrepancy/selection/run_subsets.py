"""Runs in which something may act that does not act in all."""

from __future__ import annotations

from collections.abc import Sequence

from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.selection.linearised import Linearised

AS_GOOD = 6.0  # squares that one choice of runs may leave more than a shorter one: by chance as much in one case of fifty


def spans(files: Sequence[str]) -> list[tuple[str, ...]]:
    """Runs in which something may act that does not act in all: from one on, until one, in one."""
    count = len(files)
    spans = {(first, count) for first in range(1, count)} | {(0, end) for end in range(1, count)} | {(k, k + 1) for k in range(count)}
    return [tuple(files[first:end]) for first, end in sorted(spans) if end - first < count]


def longest(linear: Linearised, sets: Sequence[tuple[Candidate, ...]]) -> tuple[Candidate, ...]:
    """The set that promises most whose last effect acts in as many runs as it may: where a run does not show it, it may act there, too."""
    gains = [linear.gain(effects)[0] for effects in sets]
    most = max(gains)
    return max(zip(sets, gains, strict=True), key=lambda pair: ((most - pair[1]) * linear.excess <= AS_GOOD, len(pair[0][-1].runs)))[0]

"""The page of blind trials: how often verdicts are right."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tepm_opt.report.template import Group, Row, write
from tepm_opt.studies.blind.analysis import Rate
from tepm_opt.studies.blind.run import BlindRun
from tepm_opt.studies.blind.table import CALIBRATION


def write_blind_page(path: str | Path, run: BlindRun, figures: Mapping[str, Path]) -> None:
    """Write the page of blind trials.

    Args:
        path: of the page.
        run: with what is done of it.
        figures: PNG files by name, those that there are of "rates", "detection", "reliability", "confusion".

    Raises:
        InputError: the folder cannot be written to.
    """
    found = run.analysis
    rates = [rate for rate in found.rates if rate.of]
    judged = [rate for rate in rates if rate.kept is not None]
    missed = [f"{rate.name}: {100 * rate.value:.1f} %, wanted {_limits(rate)}" for rate in judged if not rate.kept]
    rows = [Row(rate.name, "%", _cells(rate)) for rate in rates]
    if (calibration := found.reliability) is not None:
        low, high = calibration.band
        kept = calibration.error <= CALIBRATION
        wanted = f"≤ {CALIBRATION}, {'kept' if kept else 'missed'}"
        rows.append(
            Row(
                "calibration error of stated probabilities",
                "1",
                [f"{calibration.error:.3f}", wanted, str(calibration.counts.sum()), f"{low:.3f} … {high:.3f}"],
            )
        )
        missed += [f"calibration error {calibration.error:.3f}, wanted ≤ {CALIBRATION}"] * (not kept)
    groups = [Group("Trials", ["rate", "wanted", "of", "95 % interval"], rows)]
    spread = [
        Row(name, unit, [f"{value:.0f}" for value in np.percentile(values, [50, 5, 95])])
        for name, unit, values in (
            ("gap closed where the answer is right", "%", 100 * found.closed),
            ("processor time of a verdict", "s", found.seconds),
        )
        if len(values)
    ]
    groups += [Group("Over all trials", ["median", "5 %", "95 %"], spread)] * bool(spread)
    of = len(judged) + (calibration is not None)
    sentence = (
        f"{of - len(missed)} of {of} limits are kept in {len(found.judged)} trials." if of else f"{len(found.judged)} trials, none judged."
    )
    status = "bad" if missed else "good" if of and run.ok else "partial"
    write(
        path, "blind.html", figures,
        sentence=sentence, missed=missed, status=status, groups=groups, seed=run.series.seed, done=run.ok, message=run.outcome.message,
    )  # fmt: skip


def _limits(rate: Rate) -> str:
    """The limits that a rate shall keep."""
    return ", ".join([f"≥ {100 * rate.least:.2g} %"] * (rate.least > 0) + [f"≤ {100 * rate.most:.2g} %"] * (rate.most < 1))


def _cells(rate: Rate) -> list[str]:
    low, high = rate.interval
    wanted = "" if rate.kept is None else f"{_limits(rate)}, {'kept' if rate.kept else 'missed'}"
    return [f"{100 * rate.value:.1f}", wanted, str(rate.of), f"{100 * low:.1f} … {100 * high:.1f}"]

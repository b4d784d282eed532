"""A soft arm that others measured: a lag of its pressures, a lag of its body behind the gauges, a contact in one trial."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.trials import read_trials
from tepm_opt.discrepancy.assessment.result import Verdict, VerdictStatus
from tepm_opt.discrepancy.state import Discovery
from tepm_opt.jobs.discrepancy import run_discrepancy
from tepm_opt.jobs.plants import load_plant
from tests.measured.prepared import EXAMPLES, prepared

pytestmark = pytest.mark.slow
PUBLISHED_LIMIT = 3.6e-3  # m


def lateral(found: Discovery, model: str) -> float:
    """Root mean square over time of the tip's distance across the arm, in m, on the run to validate."""
    (k,) = (k for k, run in enumerate(found.dataset.runs) if run.role == "validation")
    left = found.dataset.runs[k].points - found.predictions[model][k]
    return float(np.sqrt(np.nanmean((left**2).sum(axis=(1, 2)))))


def sure(verdict: Verdict) -> set[str]:
    return {each.candidate.name for each in (*verdict.effects, *verdict.rivals) if each.probability > 0.5}


def test_pressures_that_follow_late_are_named_and_predict_other_cycles(tmp_path: Path) -> None:
    found = run_discrepancy(prepared("pneumatic_arm", tmp_path / "data"), tmp_path / "out", plant=EXAMPLES / "pneumatic_arm.py")
    verdict = found.verdict
    largest = max(verdict.effects, key=lambda each: each.closes)
    assert largest.candidate.name == "pressure_lag", verdict.paragraph
    assert largest.probability > 0.5
    filling, exhausting = (largest.parameters[name] for name in ("filling", "exhausting"))
    assert 0.5 < exhausting.value < 5.0, "s; regulator and body together"
    assert exhausting.std < 0.5
    assert abs(filling.value - exhausting.value) < 2 * filling.std, "how long filling takes these data hardly tell"
    assert sure(verdict) <= {"pressure_lag", "hysteresis"}, verdict.paragraph
    assert lateral(found, "recalibrated") > 12e-3
    assert lateral(found, "corrected") <= PUBLISHED_LIMIT


def test_behind_the_gauges_it_is_the_body_that_lags(tmp_path: Path) -> None:
    data = prepared("pneumatic_arm_gauges", tmp_path / "data")
    verdict = run_discrepancy(data, tmp_path / "out", plant=EXAMPLES / "pneumatic_arm.py").verdict
    assert sure(verdict) <= {"creep"}, verdict.paragraph
    assert sure(verdict) or verdict.status is VerdictStatus.UNEXPLAINED
    stages = {each.candidate.stage for each in (*verdict.effects, *verdict.rivals) if not each.candidate.gauge}
    assert "input" not in stages


def test_a_contact_is_told_by_its_time(tmp_path: Path) -> None:
    """It touches something 8 s after the start of the second trial; both are fitted to, so that an effect of the whole could be named."""
    data = prepared("pneumatic_arm_contact", tmp_path / "data")
    verdict = run_discrepancy(data, tmp_path / "out", plant=EXAMPLES / "pneumatic_arm_contact.py").verdict
    assert not sure(verdict), verdict.paragraph
    assert verdict.status is VerdictStatus.UNEXPLAINED
    (moment,) = (place for place in verdict.where if place.by == "moment")
    assert moment.name.endswith("of touched.csv")
    begin, end = (float(part.split(" s")[0]) for part in moment.name.split(" to "))
    assert 7.5 < begin < 8.6 < end < 11.0
    assert f"from {moment.name}" in verdict.paragraph


def test_the_split_is_between_cycles(tmp_path: Path) -> None:
    """Four of six cycles to fit to; the run to validate has the others only."""
    signals = load_plant(EXAMPLES / "pneumatic_arm.py").signals
    data = read_trials(prepared("pneumatic_arm", tmp_path), signals)
    (fit,), (validation,) = data.fit, data.validation
    rises = [(run.time[1:][np.diff(run.inputs[:, 0]) > 1]) for run in (fit, validation)]
    assert len(rises[0]) == 4
    assert len(rises[1]) == 6
    seen = np.asarray(np.isfinite(validation.points).all(axis=(1, 2)))
    assert not seen[: fit.rows].any()
    assert seen[fit.rows :].all()
    assert rises[1][3] < fit.time[-1] < validation.time[seen][0] < rises[1][4]

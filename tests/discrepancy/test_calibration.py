"""Calibration of stated probabilities."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.discrepancy.assessment.calibration import calibrate_judgement, calibrate_probability
from tepm_opt.discrepancy.assessment.credibility import Judgement
from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.discrepancy.problem.plant import Candidate

FIRST, SECOND, OTHER = (Candidate(name, None, {f"{name}.size": 0.0}) for name in ("first", "second", "other"))


def test_an_answer_is_hardly_surer_than_its_weakest_effect() -> None:
    """The same effect is stated with less beside one that is doubtful; the order of certainty stays."""
    own = np.array([0.6, 0.9, 0.99, 0.999])
    alone, beside = calibrate_probability(own, own), calibrate_probability(own, np.full(4, 0.6))
    assert np.all(np.diff(alone) > 0)
    assert np.all(np.diff(beside) > 0)
    assert np.all(beside[1:] < alone[1:])
    assert alone[3] > 0.98


def test_alternatives_share_what_is_stated_of_their_effect() -> None:
    """Two in each other's place keep their ratio, and together state no more than one effect so sure alone."""
    fit = None
    judged = Judgement(VerdictStatus.INDISTINGUISHABLE, {}, ((FIRST, FIRST, fit, 0.6), (FIRST, OTHER, fit, 0.3)))  # type: ignore[arg-type]
    listed = calibrate_judgement(judged, ()).listed
    assert listed[0][-1] / listed[1][-1] == pytest.approx(2.0)
    assert listed[0][-1] + listed[1][-1] == pytest.approx(float(calibrate_probability(np.array([0.9]), np.array([0.9]))[0]))


def test_what_gauges_show_stays_certain() -> None:
    """An effect that was measured is no guess."""
    judged = Judgement(VerdictStatus.NAMED, {}, ((FIRST, FIRST, None, 1.0), (SECOND, SECOND, None, 0.6)))  # type: ignore[arg-type]
    listed = calibrate_judgement(judged, (FIRST,)).listed
    assert listed[0][-1] == 1.0
    assert listed[1][-1] < 0.6

"""An electronic circuit that others measured: a spring that hardens and nothing else, also beyond the range that was fitted to."""

from __future__ import annotations

from pathlib import Path

import pytest

from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.jobs.discrepancy import run_discrepancy
from tests.measured.prepared import EXAMPLES, prepared

pytestmark = pytest.mark.slow
LIMIT = 1.5e-3  # V r.m.s. on the arrow


def test_the_spring_hardens(tmp_path: Path) -> None:
    verdict = run_discrepancy(prepared("silverbox", tmp_path / "data"), tmp_path / "out", plant=EXAMPLES / "silverbox.py").verdict
    assert verdict.status is VerdictStatus.NAMED, verdict.paragraph
    assert [each.candidate.label for each in verdict.effects] == ["cubic_spring[spring]"], verdict.paragraph
    assert all(rival.probability <= 0.5 for rival in verdict.rivals)
    assert verdict.errors.recalibrated > 5e-3
    assert verdict.errors.corrected <= LIMIT
    k_3 = verdict.effects[0].parameters["force"]
    assert k_3.value / 0.1**3 / verdict.recalibrated["stiffness"].value == pytest.approx(3.95, rel=0.05)  # 1/V², k3 over k
    assert 0 < k_3.std < 0.1 * k_3.value

"""Two tanks that others measured: what runs over at high levels is named, or pointed to, and nothing else is."""

from __future__ import annotations

from pathlib import Path

import pytest

from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.jobs.discrepancy import run_discrepancy
from tests.measured.prepared import EXAMPLES, prepared

pytestmark = pytest.mark.slow


def test_tanks_run_over_or_miss_at_high_levels(tmp_path: Path) -> None:
    verdict = run_discrepancy(prepared("cascaded_tanks", tmp_path / "data"), tmp_path / "out", plant=EXAMPLES / "cascaded_tanks.py").verdict
    sure = {each.candidate.name for each in (*verdict.effects, *verdict.rivals) if each.probability > 0.5}
    assert sure <= {"overflow"}, verdict.paragraph
    if not sure:
        assert verdict.status is VerdictStatus.UNEXPLAINED, verdict.paragraph
        assert "high level" in {place.name for place in verdict.where}
        assert "more at high level" in verdict.paragraph
        assert "overflow" in verdict.paragraph, "the effect that would close most"

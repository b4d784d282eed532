"""A published formula with a memory: hysteresis is named, with all that data can tell of it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tepm_opt.data.tables import read_table
from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.jobs.discrepancy import run_discrepancy
from tests.measured.prepared import EXAMPLES

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Made here: nothing measured is needed."""
    folder = tmp_path_factory.mktemp("bouc_wen")
    subprocess.run([sys.executable, EXAMPLES / "measured.py", "bouc_wen", "nowhere", folder], check=True, timeout=300)
    return folder


def test_the_data_are_those_of_the_formula(data: Path) -> None:
    """Against another integrator, the force between samples by its sines."""
    columns = read_table(data / "0.csv").columns
    time, force = columns["time_s"], columns["force"]
    rows = 8 + 2048
    spectrum = np.fft.rfft(force[8:rows]) / 1024
    hertz = np.fft.rfftfreq(2048, 1 / 750)
    used = np.abs(spectrum) > 1e-9
    assert force[8:rows].std() == pytest.approx(50.0, rel=0.01)
    assert hertz[used].min() >= 5.0
    assert hertz[used].max() <= 150.0

    def rates(t: float, x: np.ndarray) -> list[float]:
        f = float((spectrum[used] * np.exp(2j * np.pi * hertz[used] * (t - 8 / 750))).sum().real) if t >= 8 / 750 else 0.0
        q, v, z = x
        return [v, (f - 10 * v - 5e4 * q - z) / 2, 5e4 * v - 800 * abs(v) * z + 1100 * v * abs(z)]

    motion = solve_ivp(rates, (0, time[300]), [0.0, 0.0, 0.0], "DOP853", time[:300], rtol=1e-8, atol=1e-12, max_step=1e-4)
    left = columns["position"][:300] - motion.y[0]
    assert left.std() == pytest.approx(8e-6, rel=0.15)


def test_hysteresis_and_its_six_numbers(data: Path, tmp_path: Path) -> None:
    verdict = run_discrepancy(data, tmp_path / "out", plant=EXAMPLES / "bouc_wen.py").verdict
    assert verdict.status is VerdictStatus.NAMED, verdict.paragraph
    assert [each.candidate.label for each in verdict.effects] == ["hysteresis[guide]"], verdict.paragraph
    found = {name: value.value for name, value in verdict.effects[0].parameters.items()}
    found |= {name: value.value for name, value in verdict.recalibrated.items()}
    expected = {"mass": 2.0, "damper": 10.0, "spring": 5e4, "stiffness": 5e4, "closing": 800.0, "opening": -1100.0}
    assert found == {name: pytest.approx(value, rel=0.05) for name, value in expected.items()}
    assert verdict.errors.corrected < 1.3 * 8e-6  # the force begins with a jump, which no band holds

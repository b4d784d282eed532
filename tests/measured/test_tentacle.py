"""22 static pulls of a silicone tentacle that others measured: what a rod says of pulls left out, and that nothing is named."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.run import RunSet
from tepm_opt.data.trials import read_trials
from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.discrepancy.pipeline import discover
from tepm_opt.jobs.discrepancy import run_discrepancy
from tepm_opt.jobs.plants import load_plant
from tests.paths import SHARED

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
PUBLISHED_FIT, PUBLISHED_NETWORK = 15.8, 6.4  # mm, mean marker error of the publication's fit, and of its network on what the fit leaves

pytestmark = pytest.mark.slow


def ran(*arguments: str | Path) -> str:
    return subprocess.run([sys.executable, *arguments], check=True, capture_output=True, text=True, timeout=600).stdout


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if not (SHARED / "real" / "soromox_tendon_tentacle").is_dir():
        pytest.skip(f"the tentacle's recordings are not in {SHARED}")
    folder = tmp_path_factory.mktemp("tentacle")
    ran(EXAMPLES / "measured.py", "tentacle", SHARED, folder)
    return folder


def test_pulls_left_out_are_predicted(data: Path) -> None:
    """Each by a fit of its own to all the others, from the same first values."""
    lines = ran(EXAMPLES / "measured_tentacle.py", data).splitlines()
    found = re.fullmatch(r"mean marker error of pulls left out: (.*) mm", lines[-1])
    assert found
    assert len(lines) == 24
    whole, smooth = (float(value) for value in re.findall(r"([\d.]+) mm", lines[-2]))
    assert 0.9 * whole < smooth < whole, "neighbouring pulls share hardly anything: the data carry no law of the tensions"
    assert float(found[1]) < PUBLISHED_NETWORK < PUBLISHED_FIT


def test_nothing_is_named_that_the_data_cannot_carry(data: Path, tmp_path: Path) -> None:
    verdict = run_discrepancy(data, tmp_path, plant=EXAMPLES / "tentacle.py").verdict
    assert verdict.status is VerdictStatus.UNEXPLAINED, verdict.paragraph
    assert not verdict.effects
    assert all(rival.probability <= 0.5 for rival in verdict.rivals)
    assert [(place.by, place.name) for place in verdict.where][:1] == [("point", "p4")]
    assert "most at p4" in verdict.paragraph
    assert verdict.errors.recalibrated < 8e-3
    assert "NaN" not in json.dumps(verdict.as_json())


def test_what_is_hidden_in_such_pulls_would_be_named(data: Path) -> None:
    """The same pulls of a made tentacle with slack in a tendon: that nothing is named of the measured one is no lack of power."""
    plant, random = load_plant(EXAMPLES / "tentacle.py"), np.random.default_rng(1)
    body = {
        "bend_1": 1.2,
        "bend_2": 1.2,
        "taper": 0.45,
        "weight": 74.0,
        "shortening": 0.013,
        "base_z[first]": 0.046,
        "base_z[second]": 0.04,
    }
    truth = plant.with_values({**body, "tendon_slack[tension_1].slack": 1.0})
    runs = read_trials(data, plant.signals, static=True).runs
    made = [truth.predict(run).points + random.normal(0, 1e-3, run.points.shape) for run in runs]
    found = discover(RunSet.from_runs("made", [replace(run, points=at) for run, at in zip(runs, made, strict=True)]), plant, 1e-3).verdict
    assert [each.candidate.label for each in found.effects] == ["tendon_slack[tension_1]"], found.paragraph
    assert found.effects[0].parameters["slack"].value == pytest.approx(1.0, abs=0.1)
    assert found.effects[0].probability > 0.9

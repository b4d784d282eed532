"""The study: its table, its page, its files; the whole of it only by `pytest -m study`."""

import hashlib
import json

import numpy as np
import pytest

from tepm_opt.cli import run
from tepm_opt.studies.paper.load import hysteresis
from tepm_opt.studies.paper.published import PUBLISHED, is_reproduced
from tepm_opt.studies.paper.run import EXPERIMENTS, select_experiments
from tepm_opt.studies.paper.single import stiffness
from tests.hw.rigs import AREA, LENGTH, STIFFNESS


def test_published_numbers_are_those_of_the_specification():
    """SPEC section 3; every number belongs to an experiment."""
    values = [entry.value for entry in PUBLISHED.values()]
    assert values[:9] == [70.0, 358.86, 15.5, 1.85, 3.10, 2.67, 0.81, 0.93, 0.85]
    assert values[15:] == [5.32, 1.5, 7.4, 8.75, 2.8, 11.3, 20.1, 2.0, 2.0, 8.60, 65.0, 7.0, 5.41, 1.33, 9.77, 5.60]
    assert {entry.figure for entry in PUBLISHED.values()} == set(EXPERIMENTS)
    assert is_reproduced("fig7_rmse", 5.32 * 1.149)
    assert not is_reproduced("fig7_rmse", 5.32 * 0.849)


def test_order_and_names_of_experiments():
    assert select_experiments(["fig9", "fig7"]) == ["fig7", "fig9"]
    assert select_experiments([]) == list(EXPERIMENTS)
    assert run(["study", "paper", "--figure", "fig5"]) == 2


def test_hysteresis_of_a_made_loop():
    """Bending 10 % behind and return 10 % ahead of a line: 20 % wide; what is left at the end is the residual."""
    force = np.concatenate([np.linspace(0, 1, 101), np.linspace(1, 0, 101)])
    angle = np.concatenate([np.linspace(0, 1, 101) ** 1, np.linspace(1, 0.05, 101)])
    width, left = hysteresis(force, angle)
    assert width == pytest.approx(0.049, abs=1e-3)
    assert left == pytest.approx(0.05)


def test_stiffness_of_a_linear_actuator_with_dead_ends():
    """III.B's linear range: what happens below 0.05 and above 0.45 MPa does not count."""
    pressures = np.linspace(0, 0.5e6, 11)
    lengths = LENGTH + AREA * pressures / STIFFNESS
    lengths[[0, -1]] += [3e-3, -2e-3]
    assert stiffness(AREA, pressures, lengths) == pytest.approx(STIFFNESS)


@pytest.mark.slow
def test_quick_study_leaves_a_page_and_the_same_bytes_twice(tmp_path, capsys):
    """Fig. 7 alone: page with published and ours, JSON, CSV, PNG; a second run is equal byte for byte."""
    digests = []
    for name in ("one", "two"):
        folder = tmp_path / name
        assert run(["study", "paper", "--figure", "fig7", "--quick", "--out", str(folder)]) == 0
        files = sorted(folder.iterdir())
        assert [file.name for file in files] == ["fig7.csv", "fig7.png", "index.html", "paper.json"]
        digests.append([hashlib.sha256(file.read_bytes()).hexdigest() for file in files])
    assert digests[0] == digests[1]
    assert "the middle of 1 run by Eq. (5)" in (tmp_path / "one" / "index.html").read_text(encoding="utf-8")
    capsys.readouterr()
    summary = json.loads((folder / "paper.json").read_text(encoding="utf-8"))
    rows = {row["key"]: row for row in summary["rows"]}
    assert set(rows) == {"fig7_rmse", "fig7_s1", "fig7_s4"}
    assert all(row["within"] for row in rows.values())
    page = (folder / "index.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 1
    for text in ("5.32", "within 15 %", "Quick study", f"{rows['fig7_rmse']['ratio']:.2f}"):
        assert text in page
    assert not any(link in page for link in ("http://", "https://", 'src="/'))


@pytest.mark.study
def test_whole_study(tmp_path):
    """At least 12 published numbers within 15 % with one set of sizes; order and signs as the paper says."""
    assert run(["study", "paper", "--out", str(tmp_path), "--json"]) == 0
    summary = json.loads((tmp_path / "paper.json").read_text(encoding="utf-8"))
    assert summary["finished"] == list(EXPERIMENTS)
    assert {row["key"] for row in summary["rows"]} == set(PUBLISHED)
    assert summary["within_15_percent"] >= 12
    holds = {(check["figure"], check["text"]): check["holds"] for check in summary["checks"]}
    assert all(value for (figure, _), value in holds.items() if figure in ("fig7", "fig8", "fig11", "fig12")), holds

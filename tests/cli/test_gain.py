"""`tepm gain`: G of Eq. (6) along set points, as a table, a summary and a figure."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.jobs import statics as job
from tests.cli.conftest import PNG, Command
from tests.cli.tables import gain_columns, input_columns, names_in, summary, table, tips, values, write_rows

RANGE = np.repeat([0.5e6, 7.0], 6)


def test_columns_and_rows(solved_circle: Path) -> None:
    header, gains = table(solved_circle / "gain.csv")
    assert header == gain_columns()
    assert len(header) == 36
    assert (header[0], header[-1]) == ("g_1_1", "g_3_12")
    assert gains.shape == (32, 36)
    assert np.isfinite(gains).all()
    assert (solved_circle / "gain.png").read_bytes().startswith(PNG)


@pytest.mark.slow
def test_against_differences_of_statics(tepm: Command, here: Path, solved_circle: Path) -> None:
    """Every column of G at a point of the circle against central differences of `tepm statics`."""
    header, inputs = table(solved_circle / "inputs.csv")
    point, step = 5, 1e-3
    moves = np.vstack([np.diag(step * RANGE), -np.diag(step * RANGE)])
    rows = np.column_stack([np.arange(24), inputs[point, 1:] + moves])
    write_rows(here / "moved.csv", header, rows)
    assert tepm("statics", "moved.csv", "--out", "moved").status == 0
    forth, back = np.split(tips(here / "moved"), 2)
    by_differences = ((forth - back) / (2 * step)).T  # m per full range
    G = values(solved_circle / "gain.csv")[point].reshape(3, 12) * RANGE
    assert np.abs(G - by_differences).max() <= 1e-4 * np.abs(G).max()


def test_summary_agrees_with_the_table(solved_circle: Path) -> None:
    told, gains = summary(solved_circle, "gain"), values(solved_circle / "gain.csv")
    assert (told["points"], told["solved"], told["reference_point"]) == (32, 32, "s4")
    for kind, columns in (("pressure", slice(0, 6)), ("tension", slice(6, 12))):
        sigma = [np.linalg.svd(row.reshape(3, 12)[:, columns] * RANGE[columns], compute_uv=False) for row in gains]
        assert told["singular_values_m_per_range"][kind] == pytest.approx([np.min(sigma), np.max(sigma)], rel=1e-6)
    for row, numbers in zip(gains, told["normalised"], strict=True):
        scaled = row.reshape(3, 12) * RANGE
        for kind, columns in (("both", slice(None)), ("pressure", slice(0, 6)), ("tension", slice(6, 12))):
            sigma = np.linalg.svd(scaled[:, columns], compute_uv=False)
            np.testing.assert_allclose(numbers[kind]["singular_values_mm"], 1e3 * sigma, rtol=1e-6)
            assert numbers[kind]["condition"] == pytest.approx(sigma[0] / sigma[2], rel=1e-6)
            assert numbers[kind]["manipulability_m3"] == pytest.approx(np.prod(sigma), rel=1e-6)


@pytest.mark.slow
def test_another_reference_point(tepm: Command, here: Path, solved_circle: Path) -> None:
    assert tepm("gain", solved_circle / "inputs.csv", "--point", "s2", "--out", "s2").status == 0
    assert summary(here / "s2", "gain")["reference_point"] == "s2"
    G = values(here / "s2" / "gain.csv").reshape(32, 3, 12)
    tip = values(solved_circle / "gain.csv").reshape(32, 3, 12)
    assert np.linalg.norm(G, axis=(1, 2)).max() < np.linalg.norm(tip, axis=(1, 2)).min()


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_map", "drawn")
def test_map(tepm: Command, here: Path, solved_circle: Path) -> None:
    done = tepm("gain", solved_circle / "inputs.csv", "--map", "--out", "out")
    assert done.status == 0
    assert names_in(here / "out") == {"gain.csv", "gain.png", "gain_map.csv", "summary.json"}
    header, rows = table(here / "out" / "gain_map.csv")
    assert header == ["across_m", "z_m", *(f"{kind}_sigma_{k}_m" for kind in ("pressure", "tension") for k in (1, 2, 3))]
    assert rows.shape == (6, 8)
    found = rows[np.isfinite(rows[:, 2])]
    assert 0 < len(found) < 6
    # F_a = p A - lambda: in parts of their ranges, pressure is 0.5 MPa A / 7 N times as strong as tension everywhere
    np.testing.assert_allclose(found[:, 2:5], found[:, 5:8] * 0.5e6 * 50.27e-6 / 7.0, rtol=1e-9)


@pytest.mark.slow
def test_other_jobs_of_the_folder_stay(tepm: Command, here: Path, solved_circle: Path) -> None:
    shutil.copytree(solved_circle, here / "out")
    before = summary(here / "out", "ik"), (here / "out" / "inputs.csv").read_bytes()
    assert tepm("gain", "out/inputs.csv", "--out", "out").status == 0
    assert tepm("statics", "--out", "out").status == 0
    assert (summary(here / "out", "ik"), (here / "out" / "inputs.csv").read_bytes()) == before
    assert summary(here / "out", "statics")["points"] == 1


@pytest.mark.slow
@pytest.mark.usefixtures("drawn")
def test_rows_without_stable_operating_point(tepm: Command, here: Path) -> None:
    """A payload of 1 kg buckles the arm: a status with an explanation, the rest of the figure still drawn."""
    (here / "heavy.toml").write_text('robot = "kang2017"\n\n[[effects]]\nname = "payload"\nparameters = {mass = 1.0}\n')
    write_rows(here / "rest.csv", input_columns(), np.zeros((1, 13)))
    done = tepm("gain", "rest.csv", "--model", "heavy.toml", "--out", "out")
    assert done.status == 1
    assert "unstable" in done.out
    (entry,) = summary(here / "out", "gain")["unsolved"]
    assert (entry["point"], entry["status"]) == (0, "unstable")
    assert np.isnan(values(here / "out" / "gain.csv")).all()
    assert summary(here / "out", "gain")["normalised"] == [None]
    assert (here / "out" / "gain.png").exists()


@pytest.mark.slow
def test_figure_without_operating_points_warns_of_nothing(tepm: Command, here: Path) -> None:
    (here / "heavy.toml").write_text('robot = "kang2017"\n\n[[effects]]\nname = "payload"\nparameters = {mass = 1.0}\n')
    write_rows(here / "rest.csv", input_columns(), np.zeros((1, 13)))
    assert tepm("gain", "rest.csv", "--model", "heavy.toml", "--out", "out").err == ""


@pytest.mark.slow
def test_interruption_keeps_the_rows_so_far(tepm: Command, here: Path, solved_circle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    solve, calls = job.solve_statics, iter(range(100))

    def interrupted(*arguments: object) -> object:
        if next(calls) == 4:
            raise KeyboardInterrupt
        return solve(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(job, "solve_statics", interrupted)
    done = tepm("gain", solved_circle / "inputs.csv", "--out", "out")
    assert done.status == 130
    np.testing.assert_allclose(values(here / "out" / "gain.csv"), values(solved_circle / "gain.csv")[:4], rtol=1e-9, atol=1e-15)
    told = summary(here / "out", "gain")
    assert (told["points"], told["solved"], told["interrupted"]) == (32, 4, True)

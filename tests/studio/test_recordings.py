"""Recorded runs beside their models, and the verdict on them."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.run import Run, write_run
from tepm_opt.errors import InputError
from tepm_opt.models.channels import channels_of
from tepm_opt.models.compile import CompiledModel
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.studio import recordings
from tepm_opt.studio.recordings import film, open_recordings
from tests.studio.recorded import HEAVY, KNOWN, VERDICT, bend, heavy, write


def test_arrows_vanish_beside_the_right_model() -> None:
    shown = film(heavy(), bend())
    assert np.nanmax(np.abs(shown.arrows(40)[:, 1] - shown.arrows(40)[:, 0])) < 1e-12
    np.testing.assert_allclose(shown.rms(), 0, atol=1e-12)
    np.testing.assert_allclose(shown.nodes[:, -1].mean(axis=1), shown.points[:, -1], atol=1e-12)


def test_arrows_point_to_what_was_measured(kang: CompiledModel) -> None:
    """Thirty grams more: measured points are below the model's; a point that was lost has no arrow."""
    shown = film(kang, bend())
    row = 50
    one, five = shown.arrows(row), shown.arrows(row, 5.0)
    np.testing.assert_allclose(one[:, 1], bend().points[row], atol=1e-12)
    np.testing.assert_allclose(five[:, 1] - five[:, 0], 5 * (one[:, 1] - one[:, 0]))
    assert (one[:, 1, 2] < one[:, 0, 2]).all()
    assert len(shown.arrows(2)) == len(one) - 1
    gaps = np.linalg.norm(bend().points - shown.points, axis=2)
    np.testing.assert_allclose(shown.rms()[0], np.sqrt((gaps[:, 0] ** 2).mean()))


def test_rows_by_time(kang: CompiledModel) -> None:
    shown = film(kang, bend())
    assert [shown.row(time) for time in (-1.0, 0.0, 0.02, 0.039, 0.04, 99.0)] == [0, 0, 1, 1, 2, 59]


def test_equilibria(kang: CompiledModel) -> None:
    """Rows of their own, numbered where they have no time."""
    run = bend()
    static = Run("e.csv", "fit", np.full(3, np.nan), run.inputs[:3], run.tip_force[:3], run.points[:3])
    shown = film(kang, static, static=True)
    np.testing.assert_array_equal(shown.time, [0, 1, 2])
    np.testing.assert_allclose(shown.points[2], solve_statics(kang, run.inputs[2]).points, atol=1e-9)


def test_a_motion_that_does_not_come_to_the_end(kang: CompiledModel, monkeypatch: pytest.MonkeyPatch) -> None:
    def half(model: CompiledModel, setpoints: object, **named: object) -> object:
        whole = original(model, setpoints, **named)  # type: ignore[arg-type]
        short = replace(whole.setpoints, time=whole.setpoints.time[:9])
        return replace(whole, setpoints=short, levels=whole.levels[:9], points=whole.points[:9], outcome=Outcome(Ending.FAILED, "fell"))

    original = recordings.simulate
    monkeypatch.setattr(recordings, "simulate", half)
    shown = film(kang, bend())
    assert shown.message == "fell"
    assert np.isfinite(shown.nodes[8]).all()
    assert np.isnan(shown.nodes[9:]).all()
    assert shown.arrows(20).shape == (0, 2, 3)


def test_a_verdict(tmp_path: Path) -> None:
    """Validation runs first, beside the model as it was known and as it was corrected; words as they are, pictures none."""
    found = open_recordings(write(tmp_path))
    assert [run.file for run in found.runs] == ["other.csv", "bend.csv"]
    assert found.models == {"nominal": KNOWN, "corrected": replace(HEAVY, source=KNOWN.source)}
    table = "| effect | size ± std | probability |\n| --- | --- | --- |\n| payload | mass 30 ± 1 g | 1.00 |"
    assert found.verdict.startswith(f"**named**\n\n{table}\n\nThe arm carries more")
    assert "![" not in found.verdict


def test_a_verdict_of_an_earlier_version(tmp_path: Path) -> None:
    """It has no table: its paragraph is shown."""
    found = write(tmp_path)
    older = {name: value for name, value in VERDICT.items() if name not in ("table", "answer")}
    (found / "verdict.json").write_text(json.dumps(older), encoding="utf-8")
    assert open_recordings(found).verdict == "**named**\n\nMissing: payload."


def test_data_that_were_added(tmp_path: Path) -> None:
    """A verdict on several data sets has the runs of all, the later ones by their folder."""
    found = write(tmp_path)
    shutil.copytree(tmp_path / "bench", tmp_path / "more")
    (found / "verdict.json").write_text(json.dumps({**VERDICT, "data": ["../bench", "../more"]}), encoding="utf-8")
    assert [run.file for run in open_recordings(found).runs] == ["other.csv", "bend.csv", "more/bend.csv", "more/other.csv"]


def test_a_dataset_and_a_run_of_it(tmp_path: Path) -> None:
    write(tmp_path)
    whole, one = open_recordings(tmp_path / "bench"), open_recordings(tmp_path / "bench" / "other.csv")
    assert [len(each.runs) for each in (whole, one)] == [2, 1]
    assert one.runs[0].role == "validation"
    assert list(whole.models.values()) == [KNOWN]
    assert open_recordings(tmp_path / "bench", HEAVY).models == {"model": HEAVY}


def test_a_log(tmp_path: Path, kang: CompiledModel) -> None:
    """A log has targets beside what was tracked."""
    extra = {f"target_{axis}_m": np.full(60, value) for axis, value in zip("xyz", (0.1, 0.2, np.nan), strict=True)}
    (tmp_path / "loop").mkdir()
    write_run(tmp_path / "loop" / "log.csv", replace(bend(), extra=extra), channels_of(KNOWN.robot))
    for path in (tmp_path / "loop", tmp_path / "loop" / "log.csv"):
        shown = film(kang, open_recordings(path).runs[0])
        assert shown.column("target", 3) is None  # z is not known
        assert shown.column("true_tip", 3) is None
    known = replace(bend(), extra=extra | {"target_z_m": np.full(60, 0.3)})
    np.testing.assert_array_equal(film(kang, known).column("target", 3), [0.1, 0.2, 0.3])


def test_what_cannot_be_shown(tmp_path: Path) -> None:
    found = write(tmp_path)
    with pytest.raises(InputError, match=r"nothing to look at; valid: a run or log \(CSV\)"):
        open_recordings(tmp_path)
    with pytest.raises(InputError, match="nothing to look at"):
        open_recordings(tmp_path / "nosuch.csv")
    (found / "verdict.json").write_text(json.dumps({**VERDICT, "data": []}), encoding="utf-8")
    with pytest.raises(InputError, match=r"verdict\.json: does not say which data"):
        open_recordings(found)
    (found / "verdict.json").write_text("{", encoding="utf-8")
    with pytest.raises(InputError, match="damaged"):
        open_recordings(found)
    (found / "verdict.json").write_text(json.dumps(VERDICT), encoding="utf-8")
    (found / "model.toml").unlink()
    with pytest.raises(InputError, match=r"has no model\.toml"):
        open_recordings(found)
    header = (tmp_path / "bench" / "bend.csv").read_text(encoding="utf-8").splitlines()[0]
    (tmp_path / "empty.csv").write_text(header + "\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"empty\.csv"):
        open_recordings(tmp_path / "empty.csv")
    text = (tmp_path / "bench" / "bend.csv").read_text(encoding="utf-8").replace("s4_x_m", "s9_x_m")
    (tmp_path / "log.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="s4_x_m"):
        open_recordings(tmp_path / "log.csv")

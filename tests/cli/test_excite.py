"""`tepm data excite`, `tepm record standard`, `tepm data next` and `tepm discrepancy --add` from outside."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.cli import rigs
from tepm_opt.hw.registry import robot_of
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.model import Model
from tepm_opt.recording.plan import read_plan
from tests.cli.conftest import Command
from tests.discrepancy.small import changed, cut, dataset_of, measured, planned, true_values, write

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.mark.slow
class TestExcite:
    def test_writes_the_plan_and_says_what_it_will_tell(self, tepm: Command, here: Path) -> None:
        done = tepm("data", "excite", "--robot", DOCS / "one_axis.toml", "--out", "plans/axis.toml", "--json")
        assert done.err == ""
        summary = done.json()
        assert json.loads((here / "plans" / "axis.json").read_text(encoding="utf-8")) == summary
        plan = read_plan(here / "plans" / "axis.toml")
        assert len(plan.runs) == summary["runs"]
        entries = {each["effect"]: each for each in summary["effects"]}
        assert 0 < entries["time_delay"]["found"]["time_delay.delay"] < entries["time_delay"]["apart"]["time_delay.delay"]
        assert entries["payload"]["cosine"] == pytest.approx(1.0, abs=1e-6)  # one moving mass: on it or of it
        assert entries["payload"]["apart"]["payload.mass"] is None
        same = tepm("data", "excite", "--robot", DOCS / "one_axis.toml", "--out", "again.toml", "--json")
        assert same.json() == summary
        noisier = tepm(
            "data", "excite", "--robot", DOCS / "one_axis.toml", "--out", "n.toml", "--noise", 2 * summary["noise_m"], "--json"
        ).json()
        once, twice = (next(e["found"] for e in each["effects"] if e["effect"] == "time_delay") for each in (summary, noisier))
        assert twice["time_delay.delay"] == pytest.approx(2 * once["time_delay.delay"], rel=0.05)

    def test_for_people(self, tepm: Command, here: Path) -> None:
        done = tepm("data", "excite", "--robot", DOCS / "one_axis.toml", "--out", "axis.toml")
        assert "closest" in done.out
        assert "in axis.toml; sway 5.462 Hz; all numbers in axis.json" in done.out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("data", "excite", "--robot", "none"), "robot 'none' is neither a file nor built in"),
        (("data", "excite", "--noise", 0), "noise 0 m; valid: above 0"),
        (("record", "standard", "--rig", "simm", "--out", "set"), "unknown rig 'simm': did you mean 'sim'?"),
        (("data", "next", "nowhere"), "nowhere/verdict.json is not there; valid: the folder that tepm discrepancy wrote"),
        (("data", "next", "found", "--seconds", 1), "--seconds 1; valid: 5 … 600 s"),
        (("data", "next", "damaged"), "damaged/verdict.json: is damaged"),
        (("data", "next", "found"), "verdict.json: does not say which data it is about; name them with --data"),
        (("discrepancy", "found", "--plant", "p.py", "--add", "found"), "--add and --plant exclude each other"),
    ],
)
def test_wrong_input(tepm: Command, here: Path, arguments: tuple[object, ...], message: str) -> None:
    for folder, text in (("found", "{}"), ("damaged", "{")):
        (here / folder).mkdir()
        (here / folder / "verdict.json").write_text(text)
    done = tepm(*arguments)
    assert (done.status, done.out) == (2, "")
    assert message in " ".join(done.err.split())


def test_the_robot_of_a_rig(here: Path) -> None:
    assert [robot_of(text) for text in ("sim", "sim:perfect", "sim@compiled", "bench", "serial:/dev/none")] == ["kang2017"] * 5


@pytest.mark.slow
def test_record_standard_records_the_plan_of_the_rigs_robot(tepm: Command, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def refuse(text: str, robot: object) -> None:
        asked.append(f"{text} {robot!r}")
        raise RuntimeError("enough")

    monkeypatch.setattr(rigs, "open_rig", refuse)
    done = tepm("record", "standard", "--rig", "sim", "--out", "set")
    assert (done.status, len(asked)) == (1, 1)
    assert "0 of 11 runs are in set" in done.err
    assert "kang2017" in asked[0]


@pytest.fixture(scope="module")
def heavy(kang: CompiledModel) -> CompiledModel:
    model = compile_model(Model.from_robot("kang2017").with_effect("payload", mass=0.012))
    return changed(model, **true_values(model))


@pytest.mark.slow
def test_a_verdict_is_gone_on_with(tepm: Command, here: Path, heavy: CompiledModel) -> None:
    """From a verdict to a run, its plan, and the verdict with what it measured."""
    runs = [cut(run, 5.0) for run in measured(heavy, planned(("single_pressure.csv", "elongation.csv", "single_tension.csv")))]
    write(dataset_of(heavy, runs), here / "set")
    assert tepm("discrepancy", "set", "--out", "found").status in (0, 1)
    verdict = json.loads((here / "found" / "verdict.json").read_text(encoding="utf-8"))
    assert (verdict["data"], verdict["model"]) == (["../set"], None)
    done = tepm("data", "next", "found", "--out", "run.toml", "--seconds", 8, "--json")
    assert done.status == 0, done.err
    told = done.json()
    assert told["hypotheses"][0] == ["payload"]
    assert len(told["hypotheses"]) >= 2
    assert told["sigmas"] >= told["random_run"]["sigmas"] > 0
    text = (here / "run.toml").read_bytes()
    assert tepm("data", "next", "found", "--out", "run.toml", "--seconds", 8, "--json").json() == told
    assert (here / "run.toml").read_bytes() == text
    (run,) = read_plan(here / "run.toml").runs
    assert run.setpoints.time[-1] == pytest.approx(8.0, rel=0.06)
    write(dataset_of(heavy, [cut(run, 4.0) for run in measured(heavy, planned(("mixed.csv",)), seed=2)]), here / "extra")
    assert tepm("discrepancy", "set", "--add", "extra", "--out", "more").status in (0, 1)
    more = json.loads((here / "more" / "verdict.json").read_text(encoding="utf-8"))
    assert more["data"] == ["../set", "../extra"]
    assert np.isfinite(more["rmse_m"]["corrected"])

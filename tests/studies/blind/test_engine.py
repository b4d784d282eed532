"""Trials whose robot MuJoCo moves: the same bytes each time, the same robot as ours, and causes that are what their names say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.models.effects import effects
from tepm_opt.models.robot import load_robot
from tepm_opt.studies.blind.analysis import analyse_results
from tepm_opt.studies.blind.engine import ENGINES, MUJOCO
from tepm_opt.studies.blind.engine_causes import KNOWN, OTHER_MEANING_IN_MUJOCO, UNKNOWN
from tepm_opt.studies.blind.excitation import Excitation, draw_runs, excitations
from tepm_opt.studies.blind.machine import Deviation, rig_file, simulate_run
from tepm_opt.studies.blind.run import examine_trial
from tepm_opt.studies.blind.table import markdown
from tepm_opt.studies.blind.trial import CYCLE, Trial, make
from tests.studies.blind.test_analysis import Hidden, result

pytest.importorskip("mujoco", minversion="4.0", reason="older ones have no delays of actuators")
ROBOT = load_robot("kang2017")
NULL, SHORT_NULL = 4, 6  # numbers of trials of seed 0 that hide nothing, in runs of the usual length and in short ones


def shortened(file: str, rows: int) -> Excitation:
    """First rows of a run."""
    run = next(run for run in excitations(1, short=True) if run.file == file)
    asked = run.setpoints
    return replace(run, setpoints=SetPoints(asked.time[:rows], asked.inputs[:rows], asked.tip_force[:rows]))


def written(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_a_trial_has_the_same_bytes_each_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ENGINES, "engine", replace(MUJOCO, seconds=(0.46, 0.46)))
    monkeypatch.setattr("tepm_opt.studies.blind.trial.draw_runs", lambda *args: draw_runs(*args)[::4])  # the first run and one to judge by
    trial = Trial.from_number(0, SHORT_NULL, "engine")
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        make(trial).write(tmp_path / name, "data")
    first = written(tmp_path / "one")
    assert first == written(tmp_path / "two")
    assert b'"kind": "null"' in first["labels/data.json"]


def test_only_asked_for() -> None:
    assert "engine" not in CYCLE


def test_the_names_are_those_of_effects() -> None:
    random = np.random.default_rng(0)
    names = {name for cause in KNOWN.values() for name in cause(random).names}
    assert len(names) == len(KNOWN)
    assert names <= {effect.name for effect in effects()}
    assert not any(cause(random).names for cause in UNKNOWN.values())
    assert set(OTHER_MEANING_IN_MUJOCO) <= set(KNOWN)


@pytest.mark.slow
@pytest.mark.parametrize("file", ["mixed.csv", "tip_load.csv"])
def test_with_nothing_hidden_it_is_the_same_robot(file: str) -> None:
    """MuJoCo's integrator and actuators leave a tenth of the smallest noise."""
    run, factors = shortened(file, 150), Deviation(factors={"K_a": 1.02, "c_a": 0.8})
    ours = simulate_run(rig_file(ROBOT, factors, 0.0), factors, run, 0).points
    assert np.sqrt(np.mean((MUJOCO.simulate(ROBOT, factors, [run])[0] - ours) ** 2)) < 1.5e-5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "at"),
    [
        ("filtered_bladders", lambda size: {"regulator_lag": {"fill_s": size, "exhaust_s": size}}),
        ("delayed_actuators", lambda size: {"time_delay": {"delay_s": size}}),
        ("heavy_tip", lambda size: {"payload": {"mass_kg": size}}),
        ("dry_muscles", lambda size: {"structural_friction": {"sliding_N": size, "bristle_stiffness_N_per_m": 5e3}}),
        ("reeled_tendons", lambda size: {"tendon_slack": {"length_m": size, "winding_stiffness_N_per_m": 13.0}}),
    ],
)
def test_a_cause_does_what_the_rig_does_by_other_means(key: str, at: Any) -> None:
    """Most of the change is the same; friction, reel and payload differ in their form, lag and delay do not."""
    run, form = shortened("mixed.csv", 200), KNOWN[key](np.random.default_rng(1))
    plain, changed = MUJOCO.simulate(ROBOT, Deviation(), [run])[0], MUJOCO.simulate(ROBOT, form.at(form.usual), [run])[0]
    rig = Deviation(at(form.usual))
    other = simulate_run(rig_file(ROBOT, rig, 0.0), rig, run, 0).points
    assert np.linalg.norm(changed - other) < 0.25 * np.linalg.norm(changed - plain)


@pytest.mark.slow
@pytest.mark.parametrize("key", [*KNOWN, *UNKNOWN])
def test_every_cause_moves_the_robot(key: str) -> None:
    run, table = shortened("mixed.csv", 200), KNOWN | UNKNOWN
    form = table[key](np.random.default_rng(1))
    plain = MUJOCO.simulate(ROBOT, Deviation(), [run])[0]
    assert np.abs(MUJOCO.simulate(ROBOT, form.at(form.usual), [run])[0] - plain).max() > 5e-4


@pytest.mark.slow
def test_a_whole_trial() -> None:
    """Nothing is hidden, and nothing is found."""
    found = examine_trial(Trial.from_number(0, NULL, "engine"))
    assert found["error"] is None
    assert found["label"]["kind"] == "null"
    assert found["verdict"]["status"] == "no_discrepancy"


def test_the_table_has_rows_of_its_own() -> None:
    heavy: list[Hidden] = [("payload", None, 3.0)]
    wall = {"cause": "touched_wall", "names": [], "size": 0.05, "misfit_over_noise": 5.0}
    lines = [
        result("engine", [], "no_discrepancy", [], kind="null"),
        result("engine", heavy, "named", [("payload", None, 0.9)], 1),
        result("engine", heavy, "unexplained", [], 2),
        result("engine", [], "no_discrepancy", [], 3, kind="foreign", causes=[wall]),
        result("null", [], "unexplained", []),
    ]
    found = analyse_results(lines)
    rates = {rate.name: (rate.count, rate.of) for rate in found.rates}
    assert rates["MuJoCo: an alarm where nothing is hidden"] == (0, 1)
    assert rates["MuJoCo: detected"] == (2, 3)
    assert rates["MuJoCo: right, one effect"] == (1, 2)
    assert rates["MuJoCo: right, outside the library"] == (1, 1)
    assert rates["a false name above 0.5: engine"] == (0, 4)
    assert rates["an alarm where nothing is hidden"] == (1, 1)
    assert {name: (mean.value, mean.of) for name, mean in found.truth.items()} == {"engine": (0.45, 2)}
    assert "| MuJoCo: mean probability stated of a true cause | 0.450 | 2 |" in markdown(found)

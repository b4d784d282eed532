"""`tepm tune`: the replay of a log, scales that are known, what the controller takes, wrong input, the command."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tepm_opt.control.estimation.filter_tuning import MOST_TRAVEL, compare_scales, scale_noise, settings_of_explained
from tepm_opt.control.estimation.kalman_filter import DEFAULT, Estimator, FilterSettings
from tepm_opt.control.mpc.controller import Mpc, MpcSettings
from tepm_opt.control.references.reference import Reference, reference_of
from tepm_opt.discrepancy.adapters.network import with_selected_candidates
from tepm_opt.discrepancy.assessment.result import Value
from tepm_opt.errors import InputError
from tepm_opt.hw.simulation.family import random_machine
from tepm_opt.hw.simulation.rigfile import RigFile
from tepm_opt.jobs.closed_loop import LoopSetup
from tepm_opt.jobs.discrepancy import find_travel
from tepm_opt.jobs.mpc import run_closed_loop
from tepm_opt.jobs.tune import filter_inputs, read_log, run_tune
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.model import FILTER_UNITS, Model, read_model, write_model
from tests.control.study import model, prototype, reference
from tests.control.study_models import alone

EXPLAINED = {"strength_std": 0.015, "strength_drift": 0.0015}
LEVELS = {"friction_std": 0.2, "friction_drift": 0.05, "strength_std": 0.015, "strength_drift": 0.0015}


def part(rows: int) -> Reference:
    """The first rows of the circle with its approach."""
    return reference_of(model(), reference("circle").tips[:rows])


def driven(folder: Path, file: RigFile, rows: int) -> Path:
    """Folder with the log of a closed loop."""
    run_closed_loop(model(), part(rows), prototype(3, file), LoopSetup(), folder)
    return folder


@pytest.fixture(scope="module")
def short_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Log of one second on the virtual prototype."""
    return driven(tmp_path_factory.mktemp("short"), random_machine("kang2017", 60411, 0), 100) / "log.csv"


def test_the_replay_gives_what_the_controller_estimated(short_log: Path) -> None:
    run = read_log(short_log, model())
    inputs = filter_inputs(model(), run)
    estimator = Estimator(inputs.operating[0], inputs.noise[0], inputs.middle)
    found = []
    for k, points in enumerate(inputs.points):
        estimator.noise = inputs.noise[k]
        found.append(estimator.update(points).points[-1])
        if k + 1 < len(inputs.points):
            estimator.predict(inputs.forces[k], inputs.tensions[k], inputs.rates[k], inputs.operating[k + 1])
    logged = np.array([run.extra[f"estimated_tip_{axis}_m"] for axis in "xyz"]).T
    np.testing.assert_allclose(found, logged, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "friction", "travel", "falls"),
    [
        (alone(()), 0.1, None, 0.1), (random_machine("kang2017", 60411, 0), 1.0, 1.0, 0.03),
        (random_machine("kang2017", 84415, 8), 1.0, 4.0, 0.05),
    ],
    ids=["no friction", "friction of a random machine", "friction of soft bristles"],
)  # fmt: skip
def test_friction_is_as_uncertain_and_as_soft_as_the_machine_has_it(
    tmp_path: Path, file: RigFile, friction: float, travel: float | None, falls: float
) -> None:
    """On a machine that is the model nothing is uncertain; where friction is large its estimate must be free to move. On the last machine
    friction turns over in 2.8 mm at the tension that motors hold, on the second in 0.4 mm."""
    run = run_tune(model(), driven(tmp_path / "run", file, 900))
    assert run.chosen.friction == friction
    assert travel is None or run.chosen.travel == travel
    assert run.chosen.errors[-1] < (1 - falls) * run.candidates[0].errors[-1]
    assert run.model.filter == pytest.approx({name: getattr(run.chosen.settings, name) for name in FILTER_UNITS})
    told = run.summary()
    assert told["chosen"]["friction_scale"] == friction
    assert len(told["candidates"]) == 8


def test_scales_act_on_both_noise_levels_alike() -> None:
    scaled = scale_noise(DEFAULT, 0.1, 0.3)
    changed = {name: getattr(scaled, name) for name in vars(DEFAULT) if getattr(scaled, name) != getattr(DEFAULT, name)}
    assert changed == pytest.approx(LEVELS)


@pytest.mark.parametrize(
    ("by_motion", "std", "pulls", "travel"),
    [(1.0, 5e-5, 1.0, 1.05e-3), (1.0, 1e-4, 1.0, None), (0.2, 5e-5, 1.0, None), (1.0, 5e-5, 0.0, None)],
)
def test_the_travel_of_friction_is_told_at_the_tension_of_the_loop(
    by_motion: float, std: float, pulls: float, travel: float | None
) -> None:
    """3.5 times the tension of the data; nothing where it is uncertain, friction goes by the motors, or no motor pulled."""
    found = {"share": 0.3, "by_motion": by_motion, "travel": 3e-4}
    model = Model.from_robot("kang2017").with_effect("tendon_friction", **found)
    values = {name: Value(value, std, "", 0.0) for name, value in found.items()}
    named = SimpleNamespace(candidate=SimpleNamespace(name="tendon_friction", label="tendon_friction"), parameters=values)
    run = SimpleNamespace(inputs=np.hstack([np.full((5, 6), 1e5), np.full((5, 6), pulls)]))
    verdict: Any = SimpleNamespace(model=model, effects=(named,))
    data: Any = SimpleNamespace(runs=[run])
    assert find_travel(verdict, data) == (None if travel is None else pytest.approx(travel))


def test_a_verdict_s_model_has_a_travel_where_it_is_known() -> None:
    """As far as reversals are known in time; settings that are there stay."""
    model = Model.from_robot("kang2017")
    assert settings_of_explained(model, 1.05e-3).filter == pytest.approx(EXPLAINED | {"presliding_distance": 1.05e-3})
    assert settings_of_explained(model, 1e-2).filter["presliding_distance"] == MOST_TRAVEL
    assert settings_of_explained(model, 1e-4).filter["presliding_distance"] == DEFAULT.presliding_distance
    assert settings_of_explained(model, None).filter == pytest.approx(EXPLAINED)
    own = replace(model, filter={"presliding_distance": 7e-4})
    assert settings_of_explained(own, 1.05e-3).filter["presliding_distance"] == 7e-4


def test_the_controller_takes_the_levels_of_the_model_unless_it_is_told_others() -> None:
    tuned = replace(model(), model=replace(model().model, filter=LEVELS))
    path = part(2)
    assert Mpc(tuned, path).setup.filter == replace(FilterSettings(), **LEVELS)
    assert Mpc(model(), path).setup.filter == FilterSettings()
    own = FilterSettings(friction_std=1.5)
    assert Mpc(tuned, path, MpcSettings(filter=own)).setup.filter == own


def test_corrected_models_keep_the_levels() -> None:
    """As a verdict makes its corrected model."""
    tuned = replace(Model.from_robot("kang2017"), filter=LEVELS)
    corrected = with_selected_candidates(tuned, {**tuned.values, "K_a": 350.0}, ())
    assert corrected.parameters == {"K_a": 350.0}
    assert corrected.filter == LEVELS


def test_a_model_file_has_the_levels(tmp_path: Path) -> None:
    tuned = replace(Model.from_robot("kang2017").with_effect("payload", mass=0.02), filter=LEVELS)
    write_model(tuned, tmp_path / "tuned.toml")
    assert tomllib.loads((tmp_path / "tuned.toml").read_text(encoding="utf-8"))["filter"] == LEVELS
    assert read_model(tmp_path / "tuned.toml") == tuned != replace(tuned, filter={})


def spoiled(log: Path, folder: Path, column: str | None = None, value: str = "", every: int = 1) -> Path:
    """A copy of a log of which a column is left out or has another value, or only every n-th row is there."""
    header, *rows = [line.split(",") for line in log.read_text(encoding="utf-8").splitlines()]
    if column is not None:
        at = header.index(column)
        for row in [header, *rows] if not value else rows:
            row[at : at + 1] = [] if not value else [value.strip()]
    path = folder / "log.csv"
    path.write_text("\n".join(",".join(row) for row in [header, *rows[::every]]) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"column": "target_x_m"}, "'target_x_m' is missing or has gaps; valid: log.csv of tepm mpc"),
        ({"column": "target_y_m", "value": " "}, "'target_y_m' is missing or has gaps"),
        ({"column": "pressure_12_Pa"}, "'pressure_12_Pa' is missing"),
        ({"every": 2}, "samples are 0.02 s apart; valid: 0.01 s"),
        ({}, "1.00 s of closed loop are too short for tuning; valid: at least 4 s"),
    ],
)
def test_logs_that_cannot_be_used_are_refused(short_log: Path, tmp_path: Path, how: dict, said: str) -> None:
    with pytest.raises(InputError, match=f"log.csv: .*{said}"):
        run_tune(model(), spoiled(short_log, tmp_path, **how))


@pytest.mark.slow
def test_a_tip_that_was_never_tracked_is_told(short_log: Path) -> None:
    inputs = filter_inputs(model(), read_log(short_log, model()))
    long = {name: np.repeat(getattr(inputs, name)[:1], 400, axis=0) for name in ("noise", "points", "forces", "tensions", "rates")}
    long["points"][:, -1] = np.nan
    blind = replace(inputs, operating=[inputs.operating[0]] * 400, **long)
    with pytest.raises(InputError, match="the tip was not tracked"):
        compare_scales(blind, None)


def test_another_robot_is_told(short_log: Path) -> None:
    other: CompiledModel = compile_model("one_module")
    with pytest.raises(InputError, match="pressure_21_Pa"):
        run_tune(other, short_log)

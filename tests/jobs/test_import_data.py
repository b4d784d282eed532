"""From a laboratory's tables of a robot without tendons, whose tip alone is tracked, to its parameters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from tepm_opt import compile_model, open_dataset, run_check, run_identify, simulate
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.jobs.import_data import run_import
from tepm_opt.models.model import Model
from tests.data.importing.layouts import text

STIFFNESS, NOISE = 365.0, 3e-4  # N/m, 1.7 % above the robot file's; m
MAP = """robot = "kang2017"
csv = { separator = ";", decimal = "," }
time = { column = "t", unit = "ms" }
pressure = { columns = "p{n}", unit = "bar" }
position = { of = ["s4"], columns = "tip {axis}", unit = "mm" }
"""


@pytest.mark.slow
def test_pressures_and_the_tip_are_enough(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    model, random = compile_model(Model.from_robot("kang2017").with_parameters(K_a=STIFFNESS)), np.random.default_rng(0)
    time, files = np.arange(0, 20, 0.02), []
    for name in ("one", "two"):
        inputs = np.zeros((len(time), 12))
        inputs[:, :6] = 1e5
        for k in range(6):
            for start in range(60, len(time) - 60, 120):
                inputs[start : start + 90, k] = 1e5 + random.uniform(0, 6e4)
        inputs[60:] = uniform_filter1d(inputs, 25, axis=0)[60:]
        tip = simulate(model, SetPoints(time, inputs, np.zeros((len(time), 3)))).points[:, -1] + NOISE * random.normal(size=(len(time), 3))
        columns = (
            {"t": 1e3 * time}
            | {f"p{k + 1}": inputs[:, k] / 1e5 for k in range(6)}
            | {f"tip {a}": 1e3 * tip[:, k] for k, a in enumerate("xyz")}
        )
        files.append(text(tmp_path / f"{name}.csv", columns, ";", ","))
    (tmp_path / "map.toml").write_text(MAP)
    run_import(files, tmp_path / "map.toml").save(tmp_path / "set")
    assert run_check(tmp_path / "set").ok
    found = run_identify(compile_model("kang2017"), [open_dataset(tmp_path / "set")])
    assert found.summary()["parameters"]["K_a"]["value"] == pytest.approx(STIFFNESS, rel=1e-3)

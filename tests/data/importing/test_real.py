"""Tables that others measured become data sets with one map each: a soft arm (another robot), a drive, a tentacle, a circuit, two tanks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.signals import Signals
from tepm_opt.data.trials import read_trials
from tepm_opt.jobs.import_data import ImportRun, run_import
from tepm_opt.models.channels import open_dataset
from tepm_opt.models.robot import robot_text
from tests.paths import SHARED

PSI = 6894.757293168
ARM, DRIVE, TENTACLE = "real/smart_pneumatic_arm", "real/emps_friction", "real/soromox_tendon_tentacle"
SMART = """robot = "arm.toml"
rate_hz = 40
csv = {{ separator = "|", header = 0 }}
time = {{ column = 1 }}
pressure = {{ columns = [2, 3, 4], unit = "psi" }}
pressure_measured = {{ columns = [5, 6, 7], unit = "psi" }}
position = {{ of = ["s2"], columns = [15, 16, 17] }}
frame = {{ axes = {axes}, offset_m = {offset} }}
"""
EMPS = """time = { column = "t" }
rate_hz = 500
start = "measured"
inputs.force = { column = "vir", scale = 35.15 }
outputs.encoder = { column = "qm" }
noise.encoder = 1e-5
"""


def source(path: str) -> Path:
    if not (SHARED / path).exists():
        pytest.skip(f"{SHARED / path} is not on this machine")
    return SHARED / path


def made(files: list[Path], text: str, folder: Path) -> ImportRun:
    pytest.importorskip("pandas")
    assert len(text.strip().splitlines()) <= 15
    (folder / "map.toml").write_text(text, encoding="utf-8")
    run = run_import(files, folder / "map.toml")
    run.save(folder / "out")
    return run


@dataclass(frozen=True)
class Recording:
    """A recording of the arm: how its frame lies in that of its base plate, by hand from the means of the base's columns."""

    file: str
    axes: str
    offset: str
    highest: float  # psi


RECORDINGS = [
    Recording("2020_07-30_data_collect_5.txt", '["x", "y", "z"]', "[-0.1198, 0.2294, 0.0073]", 25.0),
    Recording("2020_09-07_data_collect_4.txt", '["x", "y", "z"]', "[-0.1382, -0.0974, -0.0231]", 26.78),
    Recording("0115_data_collect_1.txt", '["x", "-z", "y"]', "[-0.1193, -0.1194, -0.003]", 40.0),
    Recording("0115_data_collect_2.txt", '["x", "-z", "y"]', "[-0.1193, -0.1194, -0.003]", 40.0),
]


QUICK = RECORDINGS[1]


@pytest.mark.parametrize(
    "recording", [pytest.param(each, marks=[] if each is QUICK else pytest.mark.slow, id=each.file) for each in RECORDINGS]
)
def test_a_soft_arm(recording: Recording, tmp_path: Path) -> None:
    """Of one module, without tendons; the tip alone, with quaternions; 45 to 60 samples a second, with gaps."""
    path = source(f"{ARM}/{recording.file}")
    robot = robot_text("kang2017").replace("modules = 2", "modules = 1").replace("pressure_max_Pa = 0.5e6", "pressure_max_Pa = 0.3e6")
    (tmp_path / "arm.toml").write_text(robot.replace("base_position_m = [0.0, 0.0, -0.050]", "base_position_m = [0.0, 0.0, 0.0]"))
    run = made([path], SMART.format(axes=recording.axes, offset=recording.offset), tmp_path)
    (only,) = open_dataset(tmp_path / "out").runs
    table = np.array([[float(each) for each in line.split("|") if each.strip()] for line in path.read_text().splitlines()])
    time = table[:, 0] - table[0, 0]
    inside = time <= only.time[-1]
    assert only.duration == pytest.approx(time[-1], abs=0.025)
    commands = np.array([np.interp(time[inside], only.time, only.inputs[:, k]) for k in range(3)])
    assert np.median(np.abs(commands - PSI * table[inside, 1:4].T)) < 0.2 * PSI, "between rows it may have stepped"
    assert only.inputs.max() == pytest.approx(PSI * recording.highest, rel=1e-3)
    assert not only.inputs[:, 3:].any()
    places = table[inside, 14:17]
    turned = places if recording.axes == '["x", "y", "z"]' else places[:, [0, 2, 1]] * [1, -1, 1]
    turned = turned + np.array([float(each) for each in recording.offset.strip("[]").split(",")])
    seen = np.isfinite(only.points[:, 1]).all(axis=1)
    back = np.array([np.interp(time[inside], only.time[seen], only.points[seen, 1, k]) for k in range(3)]).T
    assert np.median(np.linalg.norm(back - turned, axis=1)) < 2e-4
    assert np.isnan(only.points[:, 0]).all()
    assert "no tension in the map" in "\n".join(run.notes)
    assert np.nanmax(only.extra["pressure_11_measured_Pa"]) == pytest.approx(PSI * table[:, 4].max(), rel=0.02)


@pytest.mark.slow
def test_a_drive(tmp_path: Path) -> None:
    """MAT files of two runs at 1 kHz, filtered to 500 Hz; read as the search for missing effects reads it."""
    files = [source(f"{DRIVE}/{name}.mat") for name in ("DATA_EMPS", "DATA_EMPS_PULSES")]
    run = made(files, EMPS, tmp_path)
    assert "DATA_EMPS_PULSES.csv is for validation, being the last" in "\n".join(run.notes)
    trials = read_trials(tmp_path / "out", Signals.from_names(["force"], ["encoder"], "m"))
    from scipy.io import loadmat

    raw = loadmat(files[0])
    (fit,) = trials.fit
    assert fit.start == "measured"
    assert fit.inputs[:, 0] == pytest.approx(35.15 * raw["vir"].ravel()[::2], abs=1e-3), "times are rounded"
    assert np.abs(fit.points[:, 0, 0] - raw["qm"].ravel()[::2]).max() < 5e-5


def test_a_tentacle(tmp_path: Path) -> None:
    """No header, places of five markers, the pull in the file's name."""
    text = """csv.header = 0
rate_hz = 60
time = { column = 2 }
inputs.tension_1 = { value = 4.6154 }
inputs.tension_2 = { value = 0.0 }
outputs.p4_x = { column = 3 }
outputs.p4_y = { column = 4 }
outputs.p4_z = { column = 5 }
noise.p4 = 1e-3
"""
    path = source(f"{TENTACLE}/m1_u015.csv")
    made([path], text, tmp_path)
    trials = read_trials(tmp_path / "out", Signals.from_names(["tension_1", "tension_2"], ["p4"], "m", axes=("x", "y", "z")))
    raw = np.loadtxt(path, delimiter=",")
    assert trials.runs[0].points[:, 0].mean(axis=0) == pytest.approx(raw[:, 2:5].mean(axis=0), abs=1e-4)
    assert np.unique(trials.runs[0].inputs).tolist() == [0.0, 4.6154]


@pytest.mark.slow
def test_a_circuit(tmp_path: Path) -> None:
    """Names in quotes, a separator at the end of each line, no time but a rate."""
    text = """time = { rate_hz = 610.3515625 }
inputs.v = { column = "V1" }
outputs.y = { column = "V2" }
noise.y = 1e-3
"""
    path = source("benchmarks/silverbox/SNLS80mV.csv")
    made([path], text, tmp_path)
    raw = np.genfromtxt(path, delimiter=",", skip_header=1, usecols=(0, 1))
    (run,) = read_trials(tmp_path / "out", Signals.from_names(["v"], ["y"], "V")).runs
    assert run.inputs[:, 0] == pytest.approx(raw[:, 0], abs=1e-12)
    assert run.points[:, 0, 0] == pytest.approx(raw[:, 1], abs=1e-9)


def test_two_tanks(tmp_path: Path) -> None:
    """A row every four seconds."""
    text = 'time.rate_hz = 0.25\ninputs.pump = { column = "uEst" }\noutputs.level = { column = "yEst" }\nnoise.level = 0.01\n'
    path = source("benchmarks/cascaded_tanks/dataBenchmark.csv")
    made([path], text, tmp_path)
    raw = np.genfromtxt(path, delimiter=",", skip_header=1, usecols=(0, 2))
    (run,) = read_trials(tmp_path / "out", Signals.from_names(["pump"], ["level"], "V")).runs
    assert run.points[:, 0, 0] == pytest.approx(raw[:, 1], abs=1e-9)
    assert run.time[1] == 4.0

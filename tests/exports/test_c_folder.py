"""The C folder: built from nothing but itself, it computes what the reference in Python does."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.exports.c_folder import FILES, HISTORY, MOTION_TOLERANCE, export_c, export_controller
from tepm_opt.models.backends.compiler import find_compiler
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.model import Model
from tepm_opt.models.robot import robot_text
from tepm_opt.outcome import Ending
from tepm_opt.solvers.linear.gain import solve_gain
from tepm_opt.solvers.mechanics.simulate import simulate
from tepm_opt.solvers.mechanics.statics import solve_statics

PERIOD, STEP, LATE = 0.05, 0.01, 0.07  # s; the second is LONGEST of example.c


def built(folder: Path) -> Path:
    """The example and the object files, compiled without optimisation; of warnings only one about vectors in calls is let pass."""
    flags, compiler = ("-std=gnu11", "-O0", "-Wall", "-Werror", "-Wno-psabi"), find_compiler() or ()
    sources = [path.name for path in sorted(folder.glob("*.c"))]
    subprocess.run([*compiler, *flags, "-c", *sources], cwd=folder, check=True, capture_output=True)
    objects = [Path(name).with_suffix(".o").name for name in sources]
    subprocess.run([*compiler, "-o", "example", *objects, "-lm"], cwd=folder, check=True, capture_output=True)
    return folder / "example"


@pytest.fixture(scope="module")
def nominal(kang: CompiledModel, tmp_path_factory: pytest.TempPathFactory, compiler: None) -> Path:
    """The example of the nominal robot."""
    folder = tmp_path_factory.mktemp("nominal")
    assert [path.name for path in export_c(kang, folder)] == list(FILES)
    return built(folder)


@pytest.fixture(scope="module")
def late() -> CompiledModel:
    """One module of four actuators in Python, with effects that remember and commands that act late."""
    text = robot_text("kang2017").replace("modules = 2", "modules = 1").replace("actuators = 3", "actuators = 4")
    text = re.sub(r"actuator_angles_deg = \[.*?\]", "actuator_angles_deg = [45, 135, 225, 315]", text)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "lab.toml").write_text(text, encoding="utf-8")
        model = Model.from_robot(Path(folder) / "lab.toml")
    for name in ("creep", "regulator_lag", "pressure_dead_zone"):
        model = model.with_effect(name)
    return compile_model(model.with_effect("time_delay", delay=LATE), backend="python")


@pytest.fixture(scope="module")
def of_late(late: CompiledModel, tmp_path_factory: pytest.TempPathFactory, compiler: None) -> Path:
    """The example of that robot."""
    folder = tmp_path_factory.mktemp("late")
    export_c(late, folder)
    return built(folder)


@dataclass(frozen=True)
class Told:
    """What the example wrote: statuses and numbers, a row each."""

    statics: np.ndarray
    motion: np.ndarray


def asked(example: Path, rows: np.ndarray) -> Told:
    """The example's statuses and numbers for rows of time, inputs and forces; NaN where there are none."""
    text = "\n".join(" ".join(map(repr, row)) for row in rows.tolist())
    done = subprocess.run([str(example)], input=text, capture_output=True, text=True, check=True)
    lines = [line.split() for line in done.stdout.splitlines()]
    told = []
    for kind in ("statics", "motion"):
        found = [[float(word) for word in line[1:]] for line in lines if line[0] == kind]
        width = max(map(len, found), default=0)
        told.append(np.array([row + [np.nan] * (width - len(row)) for row in found]))
    return Told(*told)


def rows_for(model: CompiledModel, count: int, seed: int) -> tuple[SetPoints, np.ndarray]:
    """Inputs that wander, a tip force that grows; the same as the example's rows."""
    random, layout = np.random.default_rng(seed), model.layout
    inputs = np.cumsum(random.uniform(0, 0.4 / count, (count, layout.inputs)), axis=0) * model.input_max
    setpoints = SetPoints(PERIOD * np.arange(count), inputs, np.linspace(0, 0.3, count)[:, None] * [1.0, 0.5, 0.0])
    others = np.zeros((count, 3 * layout.points - 3))
    return setpoints, np.column_stack([setpoints.time, inputs, others, setpoints.tip_force])


def apart(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference over the largest number."""
    return float(np.abs(found - expected).max() / np.abs(expected).max())


def check(example: Path, model: CompiledModel, seed: int) -> None:
    """Statics, gain and motion of an example against the reference in Python, to 1e-9."""
    setpoints, rows = rows_for(model, 8, seed)
    told, scale = asked(example, rows), np.tile(model.input_max, 3)
    assert (told.statics[:, 0] == 0).all()
    assert (told.motion[:, 0] == 0).all()
    found = [solve_statics(model, u, force) for u, force in zip(setpoints.inputs, setpoints.tip_force, strict=True)]
    seen = np.array([np.append(at.points.ravel(), at.lengths.ravel()) for at in found])
    gains = np.array([solve_gain(at).matrix.ravel() for at in found])
    assert apart(told.statics[:, 1 : 1 + seen.shape[1]], seen) < 1e-9
    assert apart(told.statics[:, 1 + seen.shape[1] :] * scale, gains * scale) < 1e-9
    moved = simulate(model, setpoints, step=STEP, tolerance=MOTION_TOLERANCE).complete()
    assert apart(told.motion[:, 1:], np.column_stack([moved.points.reshape(8, -1), moved.lengths])[1:]) < 1e-9


@pytest.mark.slow
def test_the_numbers_of_the_reference(nominal: Path, kang_python: CompiledModel) -> None:
    check(nominal, kang_python, 1)


@pytest.mark.slow
def test_another_robot_whose_commands_act_late(of_late: Path, late: CompiledModel) -> None:
    """By more than a row, so that the motion looks back."""
    check(of_late, late, 2)


@pytest.mark.slow
def test_commands_too_late_to_be_remembered(of_late: Path, late: CompiledModel) -> None:
    """Rows of 1 ms, HISTORY of which are less than the delay: told, not guessed."""
    rows = np.zeros((HISTORY + 10, 1 + late.layout.inputs + 3 * late.layout.points))
    rows[:, 0] = 1e-3 * np.arange(len(rows))
    statuses = asked(of_late, rows).motion[:, 0]
    assert set(statuses[: HISTORY - 1]) == {0}
    assert set(statuses[HISTORY - 1 :]) == {-3}


@pytest.mark.slow
def test_what_newton_does_not_reach_from_rest(nominal: Path, kang: CompiledModel) -> None:
    """The check value of SPEC section 2 under 2.5 N; what is unstable, beyond its limit or no number says so."""
    rows = np.zeros((5, 25))
    rows[:, 0], rows[1, 22] = np.arange(5), 2.5
    rows[2, 1], rows[3, 5], rows[4, 23] = 1.01 * kang.input_max[0], np.nan, np.inf
    statics = asked(nominal, rows).statics
    np.testing.assert_allclose(statics[1, 10:13] + [0, 0, 0.05], [0.27210, 0.00850, 0.26514], atol=1e-5)
    assert statics[:, 0].tolist() == [0, 0, -1, -1, -1]
    heavy = " ".join(["0"] * 24 + ["-60"])
    assert solve_statics(kang, np.zeros(12), [0, 0, -60]).outcome.ending is Ending.UNSTABLE
    assert subprocess.run([str(nominal)], input=heavy, capture_output=True, text=True, check=False).stdout == "statics 1\n"


def test_no_memory_is_taken_and_only_what_is_declared_is_seen(nominal: Path) -> None:
    if not (nm := shutil.which("nm")):
        pytest.skip("no nm on this machine")
    declared = set(re.findall(r"\b(robot_\w+)\(", (nominal.parent / "robot.h").read_text(encoding="utf-8").split("#define ROBOT_H")[1]))
    done = subprocess.run([nm, "robot_statics.o", "robot_motion.o"], cwd=nominal.parent, capture_output=True, text=True, check=True)
    symbols = [line.split()[-2:] for line in done.stdout.splitlines() if line and not line.endswith(":")]
    assert {name for kind, name in symbols if kind in "TDBC"} == declared
    assert not {name for kind, name in symbols if kind == "U" and re.search("alloc|free|printf", name)}


@pytest.mark.slow
def test_cmake_builds_it(kang: CompiledModel, tmp_path: Path, compiler: None) -> None:
    if not (cmake := shutil.which("cmake")):
        pytest.skip("no cmake on this machine")
    export_c(kang, tmp_path)
    subprocess.run([cmake, "-B", "build"], cwd=tmp_path, check=True, capture_output=True)
    subprocess.run([cmake, "--build", "build"], cwd=tmp_path, check=True, capture_output=True)
    with (tmp_path / "inputs.txt").open() as rows:
        done = subprocess.run([str(tmp_path / "build" / "example")], stdin=rows, capture_output=True, text=True, check=True)
    assert [line.split()[:2] for line in done.stdout.splitlines()] == [["statics", "0"]] + 5 * [["statics", "0"], ["motion", "0"]]


def test_the_controller_has_its_folder_too(kang: CompiledModel, tmp_path: Path, compiler: None) -> None:
    from tepm_opt.jobs.course import Course, whole_reference
    from tepm_opt.solvers.planning.trajectories import circle

    reference = whole_reference(kang, circle(20, duration=2.0), Course(approach=1.0, pause=0.1, start_up=0.3))
    files = export_controller(kang, reference, tmp_path)
    assert {"controller.h", "example.c", "CMakeLists.txt"} < {path.name for path in files}
    assert all(path.stat().st_size for path in files)

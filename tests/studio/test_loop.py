"""The closed loop that somebody watches: pushed, stopped, and only ever on simulated rigs."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import tepm_opt.studio
from tepm_opt.errors import InputError
from tepm_opt.hw.guard import Stopped
from tepm_opt.hw.replay import ReplayRig
from tepm_opt.jobs.closed_loop import ClosedLoop
from tepm_opt.jobs.course import Course
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.robot import load_robot
from tepm_opt.outcome import Ending
from tepm_opt.solvers.planning.trajectories import Trajectory
from tepm_opt.studio.loop import LiveLoop, Moment, Pace, simulated_rig
from tests.studio.recorded import bend

PACKAGE = Path(tepm_opt.studio.__file__).parent
ROOT = PACKAGE.parents[1]
WAYS = ("serial", "tepm_opt.hw.board", "tepm_opt.hw.service", "tepm_opt.hw.registry")
SHORT = Course(approach=0.1, pause=0.0)


def followed(model: CompiledModel, at: float = 9.0, force: float = 0.0, stop: float = 9.0) -> tuple[ClosedLoop, list[Moment]]:
    """A loop of 0.8 s at one place, pushed along x at a time for 0.1 s, or stopped."""
    moments: list[Moment] = []

    def show(moment: Moment) -> None:
        if moments and moments[-1].time < at <= moment.time:
            loop.push(np.array([force, 0.0, 0.0]), 0.1)
        if moment.time >= stop:
            loop.stop()
        moments.append(moment)

    loop = LiveLoop(model, simulated_rig("sim:perfect", wait=lambda seconds: None), show)
    place = Trajectory(np.array([0.0, 0.7]), np.array([[0.0, 0.0, 0.35], [0.001, 0.0, 0.35]]), closed=False)
    return loop.run(place, SHORT, "mode1"), moments


def test_the_rig_is_the_robot_that_is_shown() -> None:
    """A rig that comes along is scaled to it; a file's stays what the file says."""
    robot = load_robot("one_module")
    assert simulated_rig("sim", robot=robot).robot.modules == 1
    assert simulated_rig("sim:perfect", robot=robot).robot.modules == 1
    assert simulated_rig("sim").robot.modules == 2


@pytest.mark.slow
def test_a_push_moves_the_tip_along_it(kang: CompiledModel) -> None:
    """From when it was asked for; the force is told while it lasts."""
    calm, pushed = (followed(kang, 0.3, force)[1] for force in (0.0, 0.3))
    moved = np.array([one.tip - other.tip for one, other in zip(pushed, calm, strict=True)])
    time = np.array([moment.time for moment in calm])
    assert np.abs(moved[time < 0.3]).max() < 1e-12
    last = moved[(time > 0.38) & (time < 0.45)].mean(axis=0)
    assert last[0] > 2e-4
    assert last[0] > 5 * abs(last[1])
    told = time[[moment.force.any() for moment in pushed]]
    assert told[0] == pytest.approx(0.31, abs=0.011)
    assert told[-1] == pytest.approx(0.41, abs=0.021)


def test_stop(kang: CompiledModel) -> None:
    done, moments = followed(kang, stop=0.2)
    assert done.outcome.ending is Ending.INTERRUPTED
    assert "on the page" in done.outcome.message
    assert moments[-1].time == pytest.approx(0.2, abs=0.011)


def test_stop_while_it_is_prepared(kang: CompiledModel) -> None:
    loop = LiveLoop(kang, simulated_rig(), lambda moment: None)
    loop.stop()
    place = Trajectory(np.array([0.0, 0.1]), np.array([[0.0, 0.0, 0.35], [0.001, 0.0, 0.35]]), closed=False)
    with pytest.raises(Stopped, match="on the page"):
        loop.run(place, SHORT, "mpc")


@pytest.mark.parametrize("text", ["serial:/dev/ttyACM0", "serial", "replay:run.csv", "bench", "sim:", "SIM", "sim@serial", ""])
def test_no_rig_but_simulated_ones(text: str) -> None:
    with pytest.raises(InputError, match="simulated rigs only; valid: sim, sim:FILE"):
        simulated_rig(text)


@pytest.mark.slow
def test_no_rig_object_but_simulated_ones(kang: CompiledModel) -> None:
    with pytest.raises(InputError, match="is not simulated"):
        LiveLoop(kang, ReplayRig(bend()), lambda moment: None)  # type: ignore[arg-type]


@pytest.mark.slow
def test_what_the_studio_loads_has_no_way_to_a_board() -> None:
    """In a process of its own, everything of the studio imported: nothing of the board, its service or the serial port is there."""
    names = sorted(path.stem for path in PACKAGE.glob("*.py") if path.stem != "__init__")
    code = f"""
import importlib, sys
for name in {names!r}:
    importlib.import_module("tepm_opt.studio." + name)
print(*sorted(name for name in sys.modules if name.startswith({WAYS!r})))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_the_studio_imports_nothing_by_name() -> None:
    """The import contract (tests/test_house.py runs it) sees what is written; nothing may be imported otherwise."""
    for path in PACKAGE.glob("*.py"):
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        used = {node.id for node in nodes if isinstance(node, ast.Name)} | {node.attr for node in nodes if isinstance(node, ast.Attribute)}
        assert not used & {"importlib", "__import__", "import_module", "exec", "eval"}, path


@pytest.mark.slow
def test_a_way_to_the_board_would_be_seen(tmp_path: Path) -> None:
    """The contract breaks where the studio opens rigs by the registry."""
    linter = shutil.which("lint-imports", path=str(Path(sys.executable).parent))
    if linter is None:
        pytest.skip("import-linter is not installed (extra dev)")
    shutil.copytree(ROOT / "tepm_opt", tmp_path / "tepm_opt", ignore=shutil.ignore_patterns("__pycache__", "firmware", "*.c"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    loop = tmp_path / "tepm_opt" / "studio" / "loop.py"
    loop.write_text("from tepm_opt.hw.registry import open_rig\n" + loop.read_text(encoding="utf-8"), encoding="utf-8")
    done = subprocess.run(
        [linter, "--no-cache"], cwd=tmp_path, capture_output=True, text=True, check=False, env={"PYTHONPATH": str(tmp_path)}
    )
    assert done.returncode == 1
    assert "The studio has no way to a real robot, however indirect BROKEN" in done.stdout


def test_pace() -> None:
    """It waits for what is left; up to a tenth of a second that was lost is made up for."""
    now, slept = [0.0], []

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        now[0] += seconds

    pace = Pace(sleep, lambda: now[0])
    pace(0.01)
    now[0] += 0.004
    pace(0.01)
    assert slept == pytest.approx([0.01, 0.006])
    now[0] += 0.05
    pace(0.01)
    pace(0.03)
    assert len(slept) == 2
    pace(0.03)
    assert slept[2:] == pytest.approx([0.02])
    now[0] += 5.0
    for _ in range(10):
        pace(0.01)
    assert len(slept) == 3
    pace(0.02)
    assert slept[3:] == pytest.approx([0.01])

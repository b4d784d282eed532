"""What the compiled C needs of a stack does not grow with the robot: threads have small ones. A crash ends a process, so others run it."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.datasets import DataSet, write_dataset
from tepm_opt.data.run import Run
from tepm_opt.discrepancy.adapters.network import candidates, with_all_candidates
from tepm_opt.models.backends import compiler
from tepm_opt.models.backends.ccode import Unit
from tepm_opt.models.backends.compiled import statics_unit, stepping_unit
from tepm_opt.models.channels import channels_of
from tepm_opt.models.compile import compile_model
from tepm_opt.models.dynamics import write_dynamics
from tepm_opt.models.model import Model
from tepm_opt.models.network import write_network
from tepm_opt.models.robot import load_robot, robot_text
from tepm_opt.solvers.mechanics.statics import solve_statics
from tests.tools import random_inputs, variant

STACK = 64 * 1024  # bytes, of the thread that works here; arrays of twelve segments would take more
ENOUGH = 2 * STACK  # for the libraries called besides: OpenBLAS takes 80 kB for a product of matrices on some processors
NOISE = 1e-4  # m

needs_compiler = pytest.mark.skipif(compiler.find_compiler() is None, reason="no C compiler")


def run_in_thread(code: str, stack: int, *arguments: str) -> subprocess.CompletedProcess[str]:
    """What a process says whose threads have little stack."""
    text = f"import sys, threading\nthreading.stack_size({stack})\n{code}"
    return subprocess.run([sys.executable, "-c", text, *arguments], capture_output=True, text=True, check=False, timeout=300)


EVERYTHING = """
import numpy as np
from tepm_opt import SetPoints, circle, compile_model, solve_gain, solve_ik, solve_statics
from tepm_opt.solvers.mechanics.simulate import Directions, simulate

model = compile_model(sys.argv[1])
model.stepper

def work():
    inputs = np.r_[1e5, 0, 0, 1e5, np.zeros(8)]
    held = solve_statics(model, inputs)
    rows = np.eye(12, 18)
    status, *by = model.statics.sensitivity(held.x, held.load_case, rows, True)
    assert status == 0 and np.isfinite(np.hstack(by)).all()
    solve_gain(held)
    assert solve_ik(model, circle().positions[0]).solved
    time = np.arange(0, 0.1, 0.02)
    moving = SetPoints(time, np.outer(np.linspace(0.5, 1, len(time)), inputs), np.zeros((len(time), 3)))
    assert simulate(model, moving, directions=Directions.from_names(model, ["K_a", "r"])).solved
    threading.stack_size(int(sys.argv[2]))
    fixed = threading.Thread(target=steps, args=(moving,))
    fixed.start()
    fixed.join()

def steps(moving):
    assert simulate(model, moving, "rk4").solved
    print("done")

thread = threading.Thread(target=work)
thread.start()
thread.join()
"""


@needs_compiler
@pytest.mark.slow
def test_everything_works_on_a_small_stack(tmp_path: Path) -> None:
    file = tmp_path / "robot.toml"
    file.write_text(robot_text("kang2017").replace("segments_per_module = 6 ", "segments_per_module = 12 "), encoding="utf-8")
    said = run_in_thread(EVERYTHING, STACK, str(file), str(ENOUGH))
    assert (said.returncode, said.stdout.strip()) == (0, "done"), said.stderr


VERDICT = """
from tepm_opt import run_discrepancy

print(run_discrepancy(sys.argv[1], sys.argv[2]).verdict.status.value)
"""


@needs_compiler
@pytest.mark.slow
def test_equilibria_of_twelve_segments_are_explained_on_small_stacks(tmp_path: Path) -> None:
    """All effects with all details differentiate equilibria of a robot with weaker muscles."""
    file, folder = tmp_path / "robot.toml", tmp_path / "data"
    file.write_text(robot_text("kang2017").replace("segments_per_module = 6 ", "segments_per_module = 12 "), encoding="utf-8")
    robot = load_robot(file)
    known = Model(robot, {"K_a": 0.99 * robot.parameters.K_a}, source=str(file))
    machine = compile_model(known.with_effect("actuator_gain", "12", loss=0.2))
    random, runs = np.random.default_rng(2), []
    for k, role in enumerate(("fit", "fit", "fit", "validation")):
        inputs = random_inputs(machine, 12, 10 + k, 0.0, 0.4)
        points = np.array([solve_statics(machine, u).points for u in inputs])
        missing = np.full(len(inputs), np.nan)
        points += NOISE * random.normal(size=points.shape)
        runs.append(Run(f"run{k}.csv", role, missing, inputs, np.zeros((len(inputs), 3)), points))  # type: ignore[arg-type]
    write_dataset(DataSet("steady", str(file), channels_of(robot), tuple(runs), None, NOISE, static=True), folder)
    said = run_in_thread(VERDICT, ENOUGH, str(folder), str(tmp_path / "out"))
    assert (said.returncode, said.stdout.strip()) == (0, "named"), said.stderr


def frames(unit: Unit, folder: Path) -> dict[str, int]:
    """Bytes of stack that each function of a unit takes, by name."""
    folder.mkdir()
    (folder / "unit.c").write_text(unit.source, encoding="utf-8")
    command = ["gcc", "-O1", "-fno-math-errno", "-march=native", "-fPIC", "-fstack-usage", "-c", "unit.c", "-o", "unit.o"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    lines = (folder / "unit.su").read_text(encoding="utf-8").splitlines()
    return {place.rsplit(":", 1)[1]: int(size) for place, size, _ in (line.split("\t") for line in lines)}


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc, which says what stack functions take")
@pytest.mark.slow
def test_no_function_takes_more_stack_for_more_segments(tmp_path: Path) -> None:
    sizes: list[dict[str, int]] = []
    for segments in (2, 12):
        model = Model.from_robot(variant(geometry={"segments_per_module": segments}))
        model = with_all_candidates(model, candidates(model))
        network, dynamics = write_network(model), write_dynamics(model)
        units = {"statics": statics_unit(network), "one": stepping_unit(dynamics)}
        found = {name: frames(unit, tmp_path / f"{name}{segments}") for name, unit in units.items()}
        sizes.append({f"{name} {function}": size for name, each in found.items() for function, size in each.items()})
    few, many = sizes
    assert max(many.values()) < STACK // 2
    grown = {name: (few[name], size) for name, size in many.items() if name in few and size > few[name] + 1024}
    assert not grown, "1 kB is what a compiler may make of another loop"

"""The whole way from a data set to the missing effect, on all cores: made here, or folders given; and the memory of a long one."""

from __future__ import annotations

import itertools
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.cores import every_core
from benchmarks.dynamics import LENGTHS, random_runs
from benchmarks.goals import Goal
from benchmarks.limit import Limit
from benchmarks.parts import Session
from benchmarks.timing import Contender, Task
from tepm_opt.data.datasets import DataSet, write_dataset
from tepm_opt.data.run import Run
from tepm_opt.discrepancy.state import Discovery
from tepm_opt.jobs.discrepancy import run_discrepancy
from tepm_opt.models.channels import channels_of
from tepm_opt.models.compile import compile_model
from tepm_opt.models.model import Model
from tepm_opt.solvers.mechanics.simulate import simulate

HIDDEN = "payload"  # the effect that the data made here carry, at its probe values
NOISE = 1e-3  # m per axis
STEP, RATE = 5e-3, 50.0  # s of the simulation, Hz of the samples
LONG = (172.0,) * 7  # s of runs, 20 minutes in all
MEMORY = """
import resource, sys
from pathlib import Path
from tepm_opt.jobs.discrepancy import run_discrepancy
found = run_discrepancy(Path(sys.argv[1]), Path(sys.argv[2]))
unit = 1 if sys.platform == "darwin" else 1024
print(*[effect.candidate.name for effect in found.verdict.effects], resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit)
"""  # effects named and the most memory in B, of a process of its own


def _made(folder: Path, lengths: Sequence[float] = LENGTHS) -> Path:
    """A data set of the robot with the hidden effect: six runs to fit, one to validate."""
    plain = Model.from_robot("kang2017")
    machine = compile_model(plain.with_effect(HIDDEN))
    random, runs = np.random.default_rng(2), []
    for number, asked in enumerate(random_runs(machine, lengths)):
        points = simulate(machine, asked, step=STEP).complete().points
        points = points + NOISE * random.normal(size=points.shape)
        role = "fit" if number < 6 else "validation"
        runs.append(Run(f"run_{number + 1}.csv", role, asked.time, asked.inputs, asked.tip_force, points))
    write_dataset(DataSet("made by the benchmarks", "kang2017", channels_of(plain.robot), tuple(runs), RATE, NOISE), folder)
    return folder


def tasks(session: Session) -> list[Task]:
    """One contender a data set, and a long one; each runs once."""
    folders = session.data or (_made(session.scratch / HIDDEN),)
    number = itertools.count()

    def contender(folder: Path) -> Contender:
        def solve() -> Discovery:
            with every_core():
                return run_discrepancy(folder, session.scratch / f"verdict_{next(number)}")

        def judged(found: Discovery) -> np.ndarray:
            named = [effect.candidate.name for effect in found.verdict.effects]
            return np.array([float(not session.data and named != [HIDDEN])])

        return Contender(folder.name, solve, judged, ours=True)

    contenders = [contender(folder) for folder in folders]
    title = "From data set to verdict, all cores" + (" (what is named is not judged)" if session.data else "")
    return [Task("verdict", title, np.zeros(1), contenders, once=True), _long(session)]


def _long(session: Session) -> Task:
    """Twenty minutes of data."""
    task = Task("memory", "From 20 minutes of data to verdict, all cores", np.zeros(1), [], once=True)

    def solve() -> list[str]:
        folder = _made(session.scratch / "long", LONG)
        with every_core():
            done = subprocess.run([sys.executable, "-c", MEMORY, folder, f"{folder}_verdict"], capture_output=True, text=True, check=True)
        return done.stdout.splitlines()[-1].split()

    def judged(found: list[str]) -> np.ndarray:
        *named, memory = found
        task.figures["memory_B"] = float(memory)
        return np.array([float(named != [HIDDEN])])

    task.contenders.append(Contender(f"{sum(LONG):.0f} s, {len(LONG)} runs", solve, judged, ours=True))
    return task


def _median(task: Task, _: Limit) -> float:
    return float(np.median([contender.median for contender in task.contenders]))


def _slowest(task: Task, _: Limit) -> float:
    return max(contender.median for contender in task.contenders)


GOALS = (
    Goal("verdict", "verdict, median of the data sets, in s", "the median within 12 s on 2 cores", _median, 12),
    Goal(
        "memory",
        "memory of a verdict on 20 minutes of data, in GB",
        "1 GB of memory",
        lambda task, _: task.figures.get("memory_B", np.nan) / 1e9,
        1,
    ),
    Goal("verdict", "verdict, slowest of the data sets, in s", "the slowest within 30 s on 2 cores", _slowest, 30),
)

"""The simulated rig: the virtual prototype with everything on, by its compiled engine and by MuJoCo, alone and as `tepm play` uses it."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from benchmarks.goals import Goal, times_real
from benchmarks.parts import Session
from benchmarks.timing import Contender, Task
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import load_rig_file
from tepm_opt.jobs.play import play

SECONDS, PLAYED = 2.0, 20.0  # s of set points, of the rig alone and of `tepm play`
RATE = 50.0  # Hz of the set points
CLOSE = 2e-5  # m
ENGINES = {"tepm_opt, compiled engine": "compiled", "MuJoCo's engine, devices in Python": "mujoco"}
OURS, MUJOCO = ENGINES
ONE_BY_ONE = f"{OURS}, frame by frame"


def set_points(seconds: float) -> SetPoints:
    """Drawn pressures and tensions, linear between half seconds, in rows of a file."""
    random, knots, time = np.random.default_rng(4), np.arange(0.0, seconds + 0.6, 0.5), np.arange(round(seconds * RATE) + 1) / RATE
    levels = np.column_stack([random.uniform(0, 1.5e5, (len(knots), 6)), random.uniform(0, 3, (len(knots), 6))])
    inputs = np.column_stack([np.interp(time, knots, level) for level in levels.T])
    return SetPoints(time, inputs, np.zeros((len(time), 3)))


class _Driven:
    """A rig that follows the set points anew with every call; its answer is where the tip truly ends, from rest in the first call.

    Args:
        engine: of the rig.
        at_once: whether frames are read many at once.
    """

    def __init__(self, engine: str, at_once: bool) -> None:
        self._rig, self._asked, self._at_once = SimulatedRig(load_rig_file().with_engine(engine)), set_points(SECONDS), at_once
        self._frames = round(SECONDS * self._rig.file.tracker.rate_hz)

    def run(self) -> np.ndarray:
        """The tip in the end, (3,) in m."""
        self._rig.schedule(self._asked)
        if self._at_once:
            self._rig.read_many(self._frames)
        else:
            for _ in range(self._frames):
                self._rig.read()
        return self._rig.true_points[-1]


class _Played:
    """The whole job: approach, set points, return, journal and file; its answer are the points of the file, without noise.

    Args:
        engine: of the rig.
        folder: for the files.
    """

    def __init__(self, engine: str, folder: Path) -> None:
        file = load_rig_file().with_engine(engine)
        self._file = file.model_copy(update={"tracker": file.tracker.model_copy(update={"noise_rms_m": 0.0})})
        self._asked, self._folder, self._number, self.simulated = set_points(PLAYED), folder / engine, itertools.count(), np.nan

    def run(self) -> np.ndarray:
        """Points of all rows, (rows, points, 3) in m."""
        rig = SimulatedRig(self._file)
        done = play(rig, self._asked, rig.robot, self._folder / f"{next(self._number)}.csv")
        self.simulated = rig.time
        return done.run.points


def tasks(session: Session) -> list[Task]:
    """The rig alone and the whole job."""
    driven = [
        Contender(name, _Driven(engine, at_once).run, lambda tip: tip, ours=name != MUJOCO)
        for name, engine, at_once in ((OURS, "compiled", True), (ONE_BY_ONE, "compiled", False), (MUJOCO, "mujoco", True))
    ]
    jobs = {name: _Played(engine, session.scratch) for name, engine in ENGINES.items()}
    played = [Contender(name, job.run, lambda points: points, ours=name == OURS, slow=name == MUJOCO) for name, job in jobs.items()]
    expected, simulated = jobs[OURS].run(), jobs[OURS].simulated
    return [
        Task("rig", f"Rig: play on the virtual prototype, {SECONDS:g} s", _Driven("mujoco", True).run(), driven, CLOSE, SECONDS),
        Task("play", f"tepm play with its files, {PLAYED:g} s of set points", expected, played, CLOSE, simulated),
    ]


GOALS = (
    times_real("rig", "rig, virtual prototype, times real time", 60, "at least 60 times real time, frames at once"),
    times_real("play", "tepm play with its files, times real time", 60, "at least 60 times real time, with approach, journal and file"),
    Goal(
        "rig", "rig, MuJoCo's engine over the compiled one", "at least 20 times faster than MuJoCo's engine",
        lambda task, _: task.named(MUJOCO).over(task.contenders[0]), 20, True,
    ),
)  # fmt: skip

"""The controllers on the virtual prototype: what is run for the figures that the tests assert, and how one is told from the next."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import lru_cache
from multiprocessing import get_context

import numpy as np

from tepm_opt.control.actuation.pressure_planner import PressurePlannerSettings
from tepm_opt.control.controllers import find_controller
from tepm_opt.control.loop import Guard, LoopRecord, close_loop
from tepm_opt.control.mpc.controller import Mpc, MpcSettings, Use
from tepm_opt.control.references.reference import Reference, approach, point_by_point, reference_of, sample_tips
from tepm_opt.hw.rig import Sample
from tepm_opt.hw.simulation.bench import BenchRig
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import RigFile, load_rig_file
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.solvers.planning.trajectories import circle, lissajous
from tepm_opt.studies.paper.single import SET_POINTS, STAY, TAKEN
from tests.control.bench_arm import BenchArm, bench_settings, guided, length_reference

APPROACH, PAUSE = 3.0, 0.5  # s
SEEDS = tuple(range(1, 11))
WIDE = Guard(
    largest_error=np.inf, tracking_timeout=np.inf, tip_timeout=np.inf
)  # modes 1 and 2 leave fast references by far; a sensor may be dead
HOLD_AT, HOLD = 2.0, 8.0  # s after the approach at which something happens, and for how long is held


@lru_cache(maxsize=1)
def model() -> CompiledModel:
    """The nominal one."""
    return compile_model("kang2017")


@lru_cache(maxsize=4)
def reference(task: str, points: int = 32, move: float = 1.0, known: CompiledModel | None = None) -> Reference:
    """From a model's rest: "points" (from each to the next in `move` s), "circle", "lissajous" or "hold"; the nominal model's if absent."""
    known = known or model()
    if task == "points":
        tips, counted, number = point_by_point(circle().positions[:points], move, stay=3.0, taken=1.0)
        lead = approach(known, tips[0], APPROACH)
    else:
        if task == "hold":
            tips = np.repeat(circle().positions[:1], round((HOLD_AT + HOLD) / 0.01), axis=0)
            counted = np.ones(len(tips), dtype=bool)
        else:
            tips, counted = sample_tips(circle(400) if task == "circle" else lissajous(400))
        lead = approach(known, tips[0], APPROACH)
        lead = np.vstack([lead, np.repeat(tips[:1], round(PAUSE / 0.01), axis=0)])
        number = np.zeros(len(tips), dtype=int)
    before = len(lead)
    return reference_of(
        known, np.vstack([lead, tips]), np.concatenate([np.zeros(before, dtype=bool), counted]),
        np.concatenate([np.zeros(before, dtype=int), number]),
    )  # fmt: skip


def weaker(file: RigFile, part: float) -> RigFile:
    """The same rig with one muscle weaker by a part of its strength."""
    found = file.imperfections
    loss = {**found.actuator_gain.loss, "13": found.actuator_gain.loss["13"] + part}
    gain = found.actuator_gain.model_copy(update={"loss": loss})
    return file.model_copy(update={"imperfections": found.model_copy(update={"actuator_gain": gain})})


def prototype(seed: int, file: RigFile | None = None) -> SimulatedRig:
    """The virtual prototype, or another rig, with the noise of a run."""
    rig = SimulatedRig(file or load_rig_file())
    rig.reseed(seed)
    return rig


def follow(task: str, controller: str, seed: int, settings: MpcSettings | None = None, points: int = 32) -> LoopRecord:
    """A task by a controller; points are steps for the paper's modes, as they were for the paper. "weak circle": a muscle 20 % weaker."""
    path = reference(task.removeprefix("weak "), points, 1.0 if controller == "mpc" else 0.01)
    rig = prototype(seed, weaker(load_rig_file(), 0.20) if task.startswith("weak") else None)
    kind = find_controller(controller)
    return close_loop(rig, kind.make(model(), path, settings or kind.settings({})), model().robot, WIDE)


WEIGHTS = {"weight": 0.010, "heavy": 0.060}  # kg, put on the tip


class Disturbed(SimulatedRig):
    """The virtual prototype to which something happens some time after a closed loop began."""

    def __init__(self, file: RigFile, what: str, at: float) -> None:
        super().__init__(file)
        self._what, self._at = what, at

    def read(self) -> Sample:
        """As of the rig, disturbed."""
        now = self.time - self._at
        if self._what in WEIGHTS and abs(now) < 0.01:
            self.push(np.array([0.0, 0.0, -9.81 * WEIGHTS[self._what]]))
        if self._what == "side":
            self.push(np.array([0.0, 0.1 if 0 <= now < 1 else 0.0, 0.0]))
        sample = super().read()
        if (self._what == "lost" and 0 <= now < 0.5) or (self._what.startswith("dead") and now >= 0):
            points = sample.points.copy()
            points[slice(None) if self._what == "lost" else int(self._what[-1]) - 1] = np.nan
            return replace(sample, points=points)
        return sample


DISTURBANCES = ("weight", "side", "tilt", "weak", "lost", "dead1", "dead4")


def disturbed(what: str, seed: int, settings: MpcSettings | None = None, file: RigFile | None = None) -> dict[str, float]:
    """Holding the circle's first point on the virtual prototype or another rig: errors of the true tip in mm, and how near tensions came
    to their limits."""
    file = file or load_rig_file()
    file = weaker(file, 0.10) if what == "weak" else file
    if what == "tilt":
        found = file.imperfections
        found = found.model_copy(update={"base_tilt": found.base_tilt.model_copy(update={"rotation_deg": (1.0, 0.0)})})
        file = file.model_copy(update={"imperfections": found})
    path = reference("hold")
    rig = Disturbed(file, what, APPROACH + PAUSE + HOLD_AT)
    rig.reseed(seed)
    done = close_loop(rig, Mpc(model(), path, settings or MpcSettings()), model().robot, WIDE)
    error = 1e3 * np.linalg.norm(np.array(done.truth) - done.targets, axis=1)
    time = np.array(done.time) - APPROACH - PAUSE
    over = HOLD_AT + (1.0 if what == "side" else 0.5 if what == "lost" else 0.0) if what not in ("tilt", "weak") else 0.0
    tensions = np.array([command.tensions for command in done.commands])
    pressures = np.array([command.pressures for command in done.commands])
    inside = float((tensions >= 0).all() and (tensions <= 7.0).all() and (pressures >= 0).all() and (pressures <= 0.5e6).all())
    late = time >= over + 3.0
    return {
        "worst": float(error[time > 0].max()), "after": float(error[late].max()), "inside": inside,
        "rms_after": float(np.sqrt((error[late] ** 2).mean())),
        "least": float(tensions[late].mean(axis=0).min()), "most": float(tensions[late].mean(axis=0).max()),
    }  # fmt: skip


ABLATIONS = {
    "all": MpcSettings(),
    "resolution ignored": MpcSettings(pressure_planner=PressurePlannerSettings(quantised=False)),
    "no mid-ranging": MpcSettings(mid_ranging=False),
    "tension only": MpcSettings(use=Use.TENSION),
    "pressure only": MpcSettings(use=Use.PRESSURE),
}


@lru_cache(maxsize=1)
def bench_model() -> CompiledModel:
    """Of the bench as an arm."""
    return compile_model(guided(BenchRig().robot))


def on_bench(seed: int) -> dict[str, float]:
    """Fig. 6's set points by the predictive controller: mean error and SD of the true length at each over the last 5 of 6 s, in mm."""
    bench = BenchRig()
    bench.reseed(seed)
    arm, path = BenchArm(bench), length_reference(bench_model(), np.array(SET_POINTS), STAY)
    done = close_loop(arm, Mpc(bench_model(), path, bench_settings()), arm.robot, replace(WIDE, approach_time=0.0))
    error, time = 1e3 * (np.array(done.truth) - done.targets)[:, 2], np.array(done.time)
    found = {}
    for k, length in enumerate(SET_POINTS):
        late = (path.point[done.rows] == k) & (time - STAY * k >= STAY - TAKEN)
        found |= {f"mean{1e3 * length:.0f}": float(np.abs(error[late]).mean()), f"sd{1e3 * length:.0f}": float(error[late].std())}
    return found


def summary(done: LoopRecord) -> dict[str, float]:
    """Figures of a run."""
    tensions = np.array([command.tensions for command in done.commands])[done.counted]
    pressures = np.array([command.pressures for command in done.commands])[done.counted]
    on_grid = np.round(pressures / model().robot.actuation.pressure_step)  # as the regulators take them
    moves = (np.diff(on_grid, axis=0) != 0).sum() / (0.01 * len(pressures))
    return {
        "true": 1e3 * done.error(), "tracked": 1e3 * done.error(False), "moves": float(moves), "tension": float(tensions.mean()),
        "least": float(tensions.min()), "most": float(tensions.max()), "fallbacks": float(sum(done.fallbacks.values())),
    }  # fmt: skip


def run(job: tuple) -> tuple[tuple, dict[str, float]]:
    """A job: ("disturbed", what, seed), ("bench", "", seed) or (task, controller or ablation, seed)."""
    if job[0] == "disturbed":
        return job, disturbed(*job[1:])
    if job[0] == "bench":
        return job, on_bench(job[2])
    if job[1] in ABLATIONS:
        return job, summary(follow(job[0], "mpc", job[2], ABLATIONS[job[1]]))
    return job, summary(follow(*job))


def everything(jobs: Iterable[tuple], workers: int = 2, show: Callable[[str], None] = lambda _: None) -> dict[tuple, dict[str, float]]:
    """All jobs, beside each other."""
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        done = {}
        for job, result in pool.map(run, jobs):
            done[job] = result
            show(json.dumps([job, result]))
        return done


if __name__ == "__main__":
    tasks = [job.split(":") for job in sys.argv[2:]]
    everything([(a, b, seed) for a, b in tasks for seed in SEEDS], int(sys.argv[1]), lambda text: print(text, flush=True))

"""Regulators and pressure monitors that are not as the robot file says: `python -m tests.control.study_valves NOISES RIG … [OPTIONS]`.

A rig is a ratio of the prototype's true lags to the file's, "perfect" for the rig without any imperfection, or SEED:NUMBER for a random
machine. Each gives a line: the true tip's error in mm rms, mean and worst of the noises, over the path and from its third second on.
`--without-monitors` removes the pressure monitors, `--noise` gives them noise in kPa, `--late` lets them read what was some s ago;
`--right` tells the controller the true lags; `--path lissajous` is another path.
"""

from __future__ import annotations

import argparse
from collections import deque
from dataclasses import replace

import numpy as np

from tepm_opt.control.loop import close_loop
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.hw.rig import Sample
from tepm_opt.hw.simulation.family import random_machine
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import RigFile, load_rig_file
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.model import Model
from tepm_opt.models.robot import load_robot
from tests.control.study import APPROACH, PAUSE, model, reference


class LateMonitors(SimulatedRig):
    """A rig whose pressure monitors read what was some samples ago.

    Args:
        file: the rig.
        late: number of samples.
    """

    def __init__(self, file: RigFile, late: int) -> None:
        super().__init__(file)
        self._seen: deque[np.ndarray | None] = deque(maxlen=late + 1)

    def read(self) -> Sample:
        """As of the rig, with late pressures."""
        sample = super().read()
        self._seen.append(sample.pressures)
        return replace(sample, pressures=self._seen[0])


def with_lags(ratio: float) -> RigFile:
    """The virtual prototype with lags that are a ratio of its own."""
    file = load_rig_file()
    lag = file.imperfections.regulator_lag
    changed = lag.model_copy(update={"fill_s": ratio * lag.fill_s, "exhaust_s": ratio * lag.exhaust_s})
    return file.model_copy(update={"imperfections": file.imperfections.model_copy(update={"regulator_lag": changed})})


def with_monitors(file: RigFile, fitted: bool, noise: float | None) -> RigFile:
    """A rig with or without pressure monitors, of a noise in kPa where it is not None."""
    values = {"fitted": fitted} if noise is None else {"fitted": fitted, "noise_rms_Pa": 1e3 * noise}
    return file.model_copy(update={"pressure_monitor": file.pressure_monitor.model_copy(update=values)})


def find_rig(name: str) -> RigFile:
    """The rig of a ratio, "perfect" or SEED:NUMBER."""
    if ":" in name:
        seed, number = map(int, name.split(":"))
        return random_machine("kang2017", seed, number)
    return load_rig_file(name) if name == "perfect" else with_lags(float(name))


def model_with_lags(file: RigFile) -> CompiledModel:
    """The nominal model with a rig's lags in its robot file."""
    robot, lag = load_robot("kang2017"), file.imperfections.active.get("regulator_lag")
    times = (0.0, 0.0) if lag is None else (file.imperfections.regulator_lag.fill_s, file.imperfections.regulator_lag.exhaust_s)
    actuation = robot.actuation.model_copy(update=dict(zip(("filling_time_s", "exhausting_time_s"), times, strict=True)))
    return compile_model(Model.from_robot(robot.model_copy(update={"actuation": actuation})))


def print_rig(name: str, asked: argparse.Namespace) -> None:
    """Print the line of a rig."""
    plain, found, told, early = find_rig(name), [], set[str](), 0
    file = with_monitors(plain, plain.pressure_monitor.fitted and not asked.without_monitors, asked.noise)
    for seed in range(1, asked.noises + 1):
        rig = LateMonitors(file, round(asked.late / 0.01))
        rig.reseed(seed)
        done = close_loop(rig, Mpc(model_with_lags(plain) if asked.right else model(), reference(asked.path)), model().robot)
        error, late = 1e3 * np.linalg.norm(np.array(done.truth) - done.targets, axis=1), np.array(done.time) > APPROACH + PAUSE + 3.0
        parts = [done.counted & part for part in (np.ones(len(late), dtype=bool), late)]
        found.append([float(np.sqrt(np.mean(error[part] ** 2))) if part.any() else np.nan for part in parts])
        early += not done.outcome.solved
        told |= {f"{about.rstrip('0123456789 ')} {time:.1f} s" for about, time in reversed(_first_told(done.telemetry, done.time).items())}
    mean, worst = np.mean(found, axis=0), np.max(found, axis=0)
    text = f"{mean[0]:.2f} ({worst[0]:.2f})  from the third second {mean[1]:.2f} ({worst[1]:.2f})"
    print(f"{name:10s}  {asked.path} {text}  stopped {early}  told {sorted(told)}", flush=True)


def _first_told(telemetry: list, time: list[float]) -> dict[str, float]:
    """When each warning was given first, in s."""
    found: dict[str, float] = {}
    for row, at in zip(telemetry, time, strict=True):
        for about in row.doubts:
            found.setdefault(about, at)
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("noises", type=int)
    parser.add_argument("rigs", nargs="+")
    parser.add_argument("--without-monitors", action="store_true")
    parser.add_argument("--noise", type=float, default=None)
    parser.add_argument("--late", type=float, default=0.0)
    parser.add_argument("--right", action="store_true")
    parser.add_argument("--path", choices=("circle", "lissajous"), default="circle")
    options = parser.parse_args()
    for each in options.rigs:
        print_rig(each, options)

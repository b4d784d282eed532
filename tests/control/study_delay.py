"""Does a part of a control period of delay count? `python -m tests.control.study_delay SEED COUNT [FIRST]` prints a line for each machine.

The nominal model's controller assumes as many periods as are whole in the machine's true delay, and one more. Errors are those of the
true tip in mm, rms, on circle and lissajous, each the mean of two noises.
"""

from __future__ import annotations

import sys

import numpy as np

from tepm_opt.control.loop import close_loop
from tepm_opt.control.mpc.controller import Mpc, MpcSettings
from tepm_opt.hw.simulation.family import random_machine
from tepm_opt.hw.simulation.rigfile import RigFile
from tepm_opt.models.robot import load_robot
from tests.control.study import WIDE, model, prototype, reference

PERIOD, NOISES, TASKS = 0.01, (1, 2), ("circle", "lissajous")


def main(seed: str, count: str, first: str = "0") -> None:
    """Print the errors of each machine, the smallest part of a period first."""
    found = []
    for number in range(int(first), int(first) + int(count)):
        file = random_machine("kang2017", int(seed), number)
        late = (file.tracker.latency_s + file.imperfections.time_delay.delay_s) / PERIOD
        errors = [_error(file, task, int(late) + more) for more in (0, 1) for task in TASKS]
        found.append((late % 1, late, *errors))
    for part, late, *errors in sorted(found):
        print(f"{late:.2f} periods, part {part:.2f}: whole {errors[0]:.2f}/{errors[1]:.2f}, one more {errors[2]:.2f}/{errors[3]:.2f}")


def _error(file: RigFile, task: str, ahead: int) -> float:
    """Mean error over noises of a controller that assumes a number of periods."""
    robot = load_robot("kang2017")
    declared = round(((robot.tracker.latency_s if robot.tracker else 0.0) + robot.actuation.command_delay_s) / PERIOD)
    settings = MpcSettings(computing=(ahead - declared) * PERIOD)
    runs = [close_loop(prototype(noise, file), Mpc(model(), reference(task), settings), robot, WIDE) for noise in NOISES]
    return float(np.mean([1e3 * run.error() for run in runs]))


if __name__ == "__main__":
    main(*sys.argv[1:])

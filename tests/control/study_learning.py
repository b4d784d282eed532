"""Rounds of learning on random machines: `python -m tests.control.study_learning SEED MACHINES` prints true errors in mm rms by round.

The circle in 8 s, the lissajous in 6 and in 3 s; every round has a noise of its own. The guard against large errors is on, as on a robot.
"""

from __future__ import annotations

import sys

import numpy as np

from tepm_opt.hw.simulation.family import random_machine
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.jobs.closed_loop import LoopSetup
from tepm_opt.jobs.course import whole_reference
from tepm_opt.jobs.rounds import RoundsTask, run_rounds
from tepm_opt.solvers.planning.trajectories import circle, lissajous
from tests.control.study import model

ROUNDS = 5
PATHS = {"circle": circle(400), "lissajous in 6 s": lissajous(400), "lissajous in 3 s": lissajous(400, duration=3.0)}


def errors(path: str, seed: int, number: int) -> list[float]:
    """Of all rounds of a machine, in mm; infinite from where one ended early."""

    def opened(lap: int) -> SimulatedRig:
        rig = SimulatedRig(random_machine("kang2017", seed, number))
        rig.reseed(lap + 1)
        return rig

    run = run_rounds(model(), RoundsTask(whole_reference(model(), PATHS[path]), LoopSetup(), ROUNDS), opened)
    found = [1e3 * loop.rms(True) if loop.ok else np.inf for loop in run.loops]
    return found + [np.inf] * (ROUNDS - len(found))


def main(seed: int, machines: int) -> None:
    """Print a line for every machine, and the means."""
    for path in PATHS:
        table = []
        for number in range(machines):
            table.append(errors(path, seed, number))
            print(f"{path:18s} machine {number:2d}: {np.round(table[-1], 2)}", flush=True)
        print(f"{path:18s} mean {np.round(np.mean(table, axis=0), 2)}, worst {np.round(np.max(table, axis=0), 2)}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))

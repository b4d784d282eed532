"""Paths by their own time and with free progress on random machines: `python -m tests.control.study_contour SEED MACHINES`.

Prints the time that what counts takes in s, and the true contour error, root mean square and largest, in mm.
"""

from __future__ import annotations

import sys

import numpy as np

from tepm_opt.control.loop import close_loop
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.control.references.path_following import contour_errors
from tepm_opt.control.references.reference import Reference
from tepm_opt.control.references.time_optimal import PaceSettings
from tepm_opt.hw.simulation.family import random_machine
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.jobs.course import Course, whole_reference
from tepm_opt.solvers.planning.trajectories import circle, lissajous
from tests.control.study import model

CASES = {
    "circle in 8 s": (circle(400), None),
    "circle, free": (circle(400), PaceSettings()),
    "lissajous in 6 s": (lissajous(400), None),
    "lissajous, free": (lissajous(400), PaceSettings()),
    "lissajous, free, 20 mm of sway": (lissajous(400), PaceSettings(sway=0.020)),
}


def driven(path: Reference, seed: int, number: int) -> tuple[float, float, float]:
    """Time in s, contour error rms and largest in mm, of one machine."""
    rig = SimulatedRig(random_machine("kang2017", seed, number))
    rig.reseed(1)
    done = close_loop(rig, Mpc(model(), path), model().robot)
    counted, rows = done.counted, np.array(done.rows)
    off = 1e3 * contour_errors(done.reference, rows[counted], np.array(done.truth)[counted])
    return counted.sum() * path.period, float(np.sqrt((off**2).mean())), float(off.max())


def main(seed: int, machines: int) -> None:
    """Print a line for every machine, and the means and the worst."""
    paths = {name: whole_reference(model(), path, Course(approach=2.0, pace=pace)) for name, (path, pace) in CASES.items()}
    table = []
    for number in range(machines):
        table.append([driven(path, seed, number) for path in paths.values()])
        print(f"machine {number:2d}: {np.round(table[-1], 2).tolist()}", flush=True)
    for name, each in zip(CASES, np.array(table).transpose(1, 0, 2), strict=True):
        print(f"{name}: mean {each.mean(axis=0).round(2)}, worst {each.max(axis=0).round(2)}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))

"""Does `tepm tune` help in closed loop? `python -m tests.control.study_tuning SEED COUNT [FIRST [MODEL]]` prints a line a machine.

A model, the nominal one if absent, drives the circle once with the hand-set filter; the filter is tuned on that log. Circle and lissajous
are then driven with both filters and two other noises. Errors are those of the true tip in mm, rms.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tepm_opt.control.loop import close_loop
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.hw.simulation.family import random_machine
from tepm_opt.hw.simulation.rigfile import RigFile
from tepm_opt.jobs.closed_loop import LoopSetup
from tepm_opt.jobs.mpc import run_closed_loop
from tepm_opt.jobs.tune import run_tune
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.model import read_model
from tests.control.study import WIDE, prototype, reference

TASKS, DRIVEN, NOISES = ("circle", "lissajous"), 3, (1, 2)


def errors(file: RigFile, known: CompiledModel) -> list[float]:
    """Mean error of circle and lissajous over noises in mm."""
    found = []
    for task in TASKS:
        path = reference(task, known=known)
        runs = [close_loop(prototype(noise, file), Mpc(known, path), known.robot, WIDE) for noise in NOISES]
        found.append(float(np.mean([1e3 * run.error() for run in runs])))
    return found


def main(seed: str, count: str, first: str = "0", model: str = "") -> None:
    """Print the errors with the hand-set and the tuned filter for each machine."""
    known = compile_model(read_model(model) if model else "kang2017")
    for number in range(int(first), int(first) + int(count)):
        file = random_machine("kang2017", int(seed), number)
        with TemporaryDirectory() as folder:
            run_closed_loop(known, reference("circle", known=known), prototype(DRIVEN, file), LoopSetup(), folder)
            run = run_tune(known, Path(folder))
        before, after = errors(file, known), errors(file, compile_model(run.model))
        scales = f"friction × {run.chosen.friction:g}, strength × {run.chosen.strength:g}"
        told = "   ".join(f"{task} {a:.2f} → {b:.2f}" for task, a, b in zip(TASKS, before, after, strict=True))
        print(f"{seed} {number}: {scales}   {told}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])

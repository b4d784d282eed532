"""Faults of tracker and gauges in closed loop: `python -m tests.control.study_faults --machines 5 --seed 71001` prints a table.

The predictive controller follows the circle on random machines; each fault sets in 1 s after the way to the circle is done. Printed are the
largest distance of the true tip from its target after the fault less that before it, the time until the fault was told and its name, and
the exit status of `tepm mpc`. `--quiet HOURS` drives machines without a fault for so long, for false alarms.
"""

from __future__ import annotations

import argparse
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any

import numpy as np

from tepm_opt.control.diagnostics.monitor import attach_monitor
from tepm_opt.control.loop import close_loop
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.hw.rig import Sample
from tepm_opt.hw.simulation.family import random_machine
from tepm_opt.hw.simulation.faults import Fault
from tepm_opt.hw.simulation.rig import SimulatedRig
from tests.control.study import APPROACH, PAUSE, model, reference

AT = APPROACH + PAUSE + 1.0
"""Time in s at which faults set in: a second on the circle."""
FAULTS: dict[str, tuple[dict[str, Any], str]] = {
    "freeze all": ({"kind": "freeze"}, "tracker frozen"),
    "freeze the tip": ({"kind": "freeze", "of": "s4"}, "s4 frozen"),
    "freeze s2": ({"kind": "freeze", "of": "s2"}, "s2 frozen"),
    "repeat every second frame": ({"kind": "repeat", "every": 2}, "tracker repeats frames"),
    "drop 30 %": ({"kind": "drop", "probability": 0.3}, "tracker drops frames"),
    "swap s2 and s3": ({"kind": "swap", "of": "s2", "with": "s3"}, "s2 and s3 are swapped"),
    "swap s3 and the tip": ({"kind": "swap", "of": "s3", "with": "s4"}, "s3 and s4 are swapped"),
    "all poses invalid": ({"kind": "invalid"}, "tracker lost"),
    "the tip's invalid": ({"kind": "invalid", "of": "s4"}, "s4 lost"),
    "freeze pressure gauge": ({"kind": "freeze", "of": "pressure_13"}, "pressure gauge 13 frozen"),
    "freeze dynamometer": ({"kind": "freeze", "of": "tension_21"}, "dynamometer 21 frozen"),
}
"""Keys of each fault in a rig file, and the name by which it is to be told."""


@dataclass(frozen=True)
class Found:
    """One run.

    Attributes:
        before, after: largest distance of the true tip from its target before and after the fault, in m.
        told: time in s from the fault to when each name was told first.
        status: exit status that the command would have.
        end: how the loop ended.
        seconds: that were driven.
    """

    before: float
    after: float
    told: dict[str, float]
    status: int
    end: str
    seconds: float


def driven(seed: int, machine: int, fault: str | None, noise: int = 1) -> Found:
    """Follow the circle on a machine with a fault; None: without one."""
    file = random_machine("kang2017", seed, machine)
    if fault is not None:
        file = file.model_copy(update={"faults": (Fault.model_validate({**FAULTS[fault][0], "from_s": AT}),)})
    rig = SimulatedRig(file)
    rig.reseed(noise)
    told: dict[str, float] = {}

    def note(sample: Sample, _: np.ndarray) -> None:
        for name in sample.faults:
            told.setdefault(name, sample.time - AT)

    done = close_loop(rig, attach_monitor(Mpc(model(), reference("circle")), model()), model().robot, observer=note)
    off, when = np.linalg.norm(np.array(done.truth) - done.targets, axis=1), np.array(done.time)
    later, earlier = off[when >= AT], off[(when >= APPROACH + PAUSE) & (when < AT)]
    doubted = any(row.doubts for row in done.telemetry)
    status = 0 if done.outcome.solved and not doubted else 1
    return Found(float(earlier.max()), float(later.max()) if len(later) else np.nan, told, status, str(done.outcome), float(when[-1]))


def _quiet(job: tuple[int, int, int]) -> tuple[tuple[str, ...], float]:
    """Names of false alarms of a run without a fault, and its length in s."""
    seed, machine, noise = job
    found = driven(seed, machine, None, noise)
    return tuple(found.told), found.seconds


def _one(job: tuple[int, int, str]) -> Found:
    return driven(*job)


def main() -> None:
    """Run what the options ask for, and print it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=5)
    parser.add_argument("--seed", type=int, default=71001)
    parser.add_argument("--quiet", type=float, default=0.0, help="hours without a fault")
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_args()
    began, jobs = time.time(), [(asked.seed, machine, fault) for fault in FAULTS for machine in range(asked.machines)]
    with ProcessPoolExecutor(asked.jobs, mp_context=get_context("spawn")) as pool:
        print(f"{'fault':27s} {'more error':>10s}  {'told after':>10s}  named  status  end")
        every = pool.map(_one, jobs)
        for fault, (_, name) in FAULTS.items():
            runs = [next(every) for _ in range(asked.machines)]
            if not runs:
                continue
            more = max(1e3 * (run.after - run.before) for run in runs)
            late, named = max(run.told.get(name, np.inf) for run in runs), sum(next(iter(run.told), "") == name for run in runs)
            statuses, ends = sorted({run.status for run in runs}), sorted({run.end for run in runs})
            line = f"{fault:27s} {more:7.1f} mm  {late:8.2f} s  {named} of {len(runs)}  {statuses}  {'; '.join(ends)}"
            print(line, sorted({other for run in runs for other in run.told} - {name}) or "", flush=True)
        hours, alarms, number = 0.0, [], 0
        while hours < asked.quiet:
            quiet = [(asked.seed, (number + k) % 20, 1 + (number + k) // 20) for k in range(20)]
            number += len(quiet)
            for names, seconds in pool.map(_quiet, quiet):
                hours += seconds / 3600
                alarms += names
            print(f"without a fault: {len(alarms)} false alarms in {hours:.2f} h {sorted(set(alarms)) or ''}", flush=True)
    print(f"{time.time() - began:.0f} s")


if __name__ == "__main__":
    main()

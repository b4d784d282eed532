"""What is left of a move of 100 mm in closed loop: `python -m tests.control.study_plans [WHAT …] [--noises N] [--machines N] [--seed S]`.

Plans, smooth and linear ramps and ramps through shapers from rest to rest through the MPC, on the virtual prototype or on random machines
of a seed. A line each: true tip's largest distance from its target on the way, and from 0.3 s after the reference's end to 2 s later; the
mean over all runs, and in brackets the largest. WHAT: plan, plan:SETTING=VALUE,…, effort:SECONDS, ramp:SECONDS, smooth:SECONDS, zv:SECONDS
or zvd:SECONDS; a table of all where absent.
"""

from __future__ import annotations

import argparse
from functools import lru_cache

import numpy as np

from tepm_opt.control.loop import close_loop
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.control.references.reference import PERIOD, Reference, approach, minimum_jerk, reference_of
from tepm_opt.hw.simulation.family import random_machine
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import RigFile, load_rig_file
from tepm_opt.solvers.kinematics.ik import solve_ik
from tepm_opt.solvers.linear.modal_model import modal_model
from tepm_opt.solvers.planning.objective import Objective
from tepm_opt.solvers.planning.plan import PlanSettings, plan_move
from tests.control.study import APPROACH, WIDE, model

START, END = np.array([0.15, 0.0, 0.35]), np.array([0.05, 0.0, 0.35])  # 100 mm apart
PAUSE, SETTLED, WATCHED = 1.0, 0.3, 2.3  # s: at the start; after the end, from when to when
TABLE = (
    "plan", "effort:0.55", "effort:0.65", "smooth:0.5", "ramp:0.3", "ramp:0.5", "ramp:1.0", "zv:0.5", "zvd:0.5",
)  # fmt: skip


def shaper(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Times in s and parts of the impulses against the slowest mode at the end (Singer and Seering, ASME JDSMC 112, 1990)."""
    local = modal_model(solve_ik(model(), END).equilibrium, modes=2)
    natural, half_width = float(np.sqrt(local.stiffness[0])), float(local.damping[0, 0]) / 2
    damped = np.sqrt(natural**2 - half_width**2)
    less = np.exp(-half_width * np.pi / damped)
    parts = np.array([1, less]) if kind == "zv" else np.array([1, 2 * less, less**2])
    return np.arange(len(parts)) * np.pi / damped, parts / parts.sum()


def tips(what: str) -> np.ndarray:
    """Tips a control period apart from START to END, (periods, 3) in m.

    Raises:
        ValueError: no such thing.
    """
    kind, _, value = what.partition(":")
    if kind in ("plan", "effort"):
        if kind == "plan":
            options = dict(option.split("=") for option in value.split(",") if option)
            settings = PlanSettings(**{name: float(number) for name, number in options.items()})
            plan = plan_move(model(), START, END, settings=settings)
        else:
            plan = plan_move(model(), START, END, Objective.EFFORT, float(value))
        if not plan.solved:
            raise ValueError(plan.outcome.message)
        time = np.append(np.arange(0.0, plan.duration, PERIOD), plan.duration)
        return np.stack([np.interp(time, plan.time, plan.tips[:, axis]) for axis in range(3)], axis=1)
    duration = float(value)
    time = np.arange(0.0, duration + PERIOD / 2, PERIOD)
    if kind in ("zv", "zvd"):
        delays, sizes = shaper(kind)
        time = np.arange(0.0, duration + delays[-1] + PERIOD, PERIOD)
        part = sum(size * np.clip((time - delay) / duration, 0, 1) for delay, size in zip(delays, sizes, strict=True))
    elif kind == "ramp":
        part = time / duration
    elif kind == "smooth":
        part = minimum_jerk(time / duration)
    else:
        raise ValueError(f"{what!r}: valid: plan, effort:S, ramp:S, smooth:S, zv:S, zvd:S")
    return START + np.asarray(part)[:, None] * (END - START)


@lru_cache(maxsize=16)
def reference(what: str) -> tuple[Reference, float]:
    """From rest to the start, a pause, the move and a stay at its end; when that begins, in s."""
    lead, moved = approach(model(), START, APPROACH), tips(what)
    before = np.repeat(START[None], round(PAUSE / PERIOD), axis=0)
    after = np.repeat(END[None], round(WATCHED / PERIOD) + 1, axis=0)
    counted = np.zeros(len(lead) + len(before) + len(moved) + len(after), dtype=bool)
    counted[len(lead) + len(before) :] = True
    return reference_of(model(), np.vstack([lead, before, moved, after]), counted), (len(moved) - 1) * PERIOD


def left(what: str, file: RigFile, noise: int) -> tuple[float, float]:
    """The true tip's largest distance from its target on the way and after it, mm."""
    path, duration = reference(what)
    rig = SimulatedRig(file)
    rig.reseed(noise)
    done = close_loop(rig, Mpc(model(), path), model().robot, WIDE)
    error = 1e3 * np.linalg.norm(np.array(done.truth) - done.targets, axis=1)[done.counted]
    time = np.arange(len(error)) * PERIOD
    return float(error[time < duration + SETTLED].max()), float(error[time >= duration + SETTLED].max())


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", default=TABLE)
    parser.add_argument("--noises", type=int, default=3)
    parser.add_argument("--machines", type=int, default=0, help="random ones instead of the prototype")
    parser.add_argument("--seed", type=int, default=900)
    options = parser.parse_args()
    robot = "kang2017"
    files = [random_machine(robot, options.seed, number) for number in range(options.machines)] or [load_rig_file()]
    for what in options.what or TABLE:
        found = np.array([left(what, file, noise) for file in files for noise in range(1, options.noises + 1)])
        way, after = (f"{row.mean():5.1f} ({row.max():4.1f})" for row in found.T)
        print(f"{what:40s} {reference(what)[1]:5.2f} s   on the way {way}   after {after}   {np.round(found[:, 1], 1)}", flush=True)


if __name__ == "__main__":
    main()

"""The whole controller at work: its step on recorded samples, and whether it keeps its period beside the simulated rig."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from rich.console import Console

from tepm_opt.control.controllers.mpc import Mpc
from tepm_opt.control.loop import close_loop
from tepm_opt.control.reference import Reference, along, approach, reference_of
from tepm_opt.hw.rig import Sample
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.trajectories import circle

RECORDED = 600  # samples


def _course(model: CompiledModel, laps: float) -> Reference:
    tips, counted = along(circle(400), laps=laps)
    lead = approach(model, tips[0], 3.0)
    return reference_of(model, np.vstack([lead, tips]), np.concatenate([np.zeros(len(lead), dtype=bool), counted]))


def recorded_step(model: CompiledModel) -> Callable[[], None]:
    """A call is one control step, from a sample to the command, on samples of the circle that were recorded in closed loop."""
    reference, samples = _course(model, 1.0), []
    rig, controller = SimulatedRig(), Mpc(model, reference)
    rig.apply(controller.start())
    for _ in range(RECORDED):
        samples.append(rig.read())
        rig.apply(controller.command(samples[-1]))
    state: list[tuple[Mpc, list[Sample]]] = []

    def step() -> None:
        if not state or not state[0][1]:
            state[:] = [(Mpc(model, reference), samples[::-1])]
        controller, left = state[0]
        controller.command(left.pop())

    step()
    return step


def keep_pace(model: CompiledModel, console: Console, seconds: float = 60.0) -> None:
    """Print how many periods a closed loop with the simulated rig, on one core, missed."""
    reference = _course(model, seconds / 8)
    done = close_loop(SimulatedRig(), Mpc(model, reference), model.robot)
    taken = np.array(done.seconds[-round(seconds / reference.period) :])
    missed = int((taken > reference.period).sum())
    figures = f"median {1e3 * np.median(taken):.2f} ms, 99 % {1e3 * np.quantile(taken, 0.99):.2f} ms, longest {1e3 * taken.max():.2f} ms"
    console.print(f"{1 / reference.period:.0f} Hz beside the simulated rig: {missed} of {len(taken)} periods missed; a step: {figures}")

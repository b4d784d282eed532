"""Levels that a robot's inputs may reach and its sway, from which levels and times of a recording plan follow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.linear.modes import modes
from tepm_opt.solvers.linear.state_space import linearise
from tepm_opt.solvers.mechanics.simulate import SimulationError, simulate
from tepm_opt.solvers.mechanics.statics import Equilibrium, solve_statics

STRETCH, BEND, PULL, PUSH = 0.17, 0.4, 0.27, 0.25  # of the arm's length: how far the tip goes by pressures, one alone, a tension, a force
MOST_COMMON, MOST_ALONE, MOST_TENSION = 0.7, 0.36, 0.72  # of the limits: beyond that nothing more is learnt
FIRM, LIGHT = 0.43, 0.23  # of the common pressure: where tendons pull, where a force acts
FORCE = 0.02  # of what a muscle pushes with at most: the largest force on the tip that is asked for
COARSE = 0.02  # s: longest time step where it only counts whether there is a motion
HALVINGS = 7  # of an interval in which a level is sought
ROWS = 60  # most set points of a run whose equilibria are looked at
SLOWEST = 0.5  # Hz that stand for the sway of a machine that does not swing


@dataclass(frozen=True)
class Reach:
    """Levels at which a robot is stable and moves well, and its sway.

    Attributes:
        sway: frequency of its slowest mode that swings in Hz.
        common: pressure of all muscles that lengthens the arm by `STRETCH`, in Pa.
        alone: pressure of one muscle of a module alone that moves the tip by `BEND`, in Pa, (modules,).
        tension: tension of one tendon of a module alone, muscles firm, that moves the tip by `PULL`, in N, (modules,).
        force: sideways on the tip that moves it by `PUSH`, in N.
    """

    sway: float
    common: float
    alone: tuple[float, ...]
    tension: tuple[float, ...]
    force: float


def reach_of(model: CompiledModel) -> Reach:
    """Levels from statics, the sway from the network linearised where its muscles are firm.

    A level is the first that moves the tip as far as wanted, at most a part of the robot's limit, and such that all up to it are stable.

    Raises:
        InputError: the robot does not stand by itself, or bears no pressure.
    """
    layout, limits = model.layout, model.input_max
    half, pressure_max, tension_max = layout.inputs // 2, float(limits[0]), float(limits[-1])
    length = model.robot.modules * model.values["L_0"]

    def solve(pressure: float, at: int | None = None, value: float = 0.0, force: float = 0.0) -> Equilibrium:
        inputs = np.append(np.full(half, pressure), np.zeros(half))
        if at is not None:
            inputs[at] = value
        return solve_statics(model, inputs, [force, 0.0, 0.0] if force else None)

    if not solve(0.0).solved:
        raise InputError(f"robot {model.robot.name}: it has no stable equilibrium without inputs: {solve(0.0).outcome.message}")
    common = _level(lambda p: solve(p), MOST_COMMON * pressure_max, STRETCH * length)
    if common <= 0:
        raise InputError(f"robot {model.robot.name}: it is not stable under any pressure of all muscles; no plan moves it")
    first = [module * layout.actuators for module in range(layout.modules)]
    firm, light = FIRM * common, LIGHT * common
    alone = tuple(_level(lambda p, k=k: solve(0.0, k, p), MOST_ALONE * pressure_max, BEND * length) for k in first)
    tension = tuple(_level(lambda t, k=k: solve(firm, half + k, t), MOST_TENSION * tension_max, PULL * length) for k in first)
    force = _level(lambda f: solve(light, force=f), FORCE * model.values["A"] * pressure_max, PUSH * length)
    swings = [mode.frequency for mode in modes(linearise(solve(firm))) if mode.oscillates]
    return Reach(min(swings, default=SLOWEST), common, alone, tension, force)


def _level(solve: Callable[[float], Equilibrium], most: float, wanted: float) -> float:
    """The level at which the tip is as far from where it was as wanted, or the largest that is stable, at most `most`."""
    start = solve(0.0).tip

    def is_small(level: float) -> bool:
        found = solve(level)
        return found.solved and float(np.linalg.norm(found.tip - start)) <= wanted

    if is_small(most):
        return most
    low, high = 0.0, most
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if is_small(middle) else (low, middle)
    return low


def unbearable(model: CompiledModel, setpoints: SetPoints, motion: bool = True) -> str:
    """Explain why a model does not bear set points: no stable equilibrium under one of them or, if asked for, no motion; else empty."""
    inside = model.allows(setpoints.inputs)
    if not inside:
        return "inputs outside the robot's limits"
    rows = np.column_stack([setpoints.inputs, setpoints.tip_force])
    firsts = np.sort(np.unique(rows, axis=0, return_index=True)[1])
    last = None
    for row in firsts[:: max(len(firsts) // ROWS, 1)]:
        found = solve_statics(model, setpoints.inputs[row], setpoints.tip_force[row], start=last)
        if not found.solved:
            return f"{setpoints.time[row]:.3g} s: {found.outcome.message}"
        last = found
    if not motion:
        return ""
    try:
        simulate(model, setpoints, step=COARSE).complete()
    except SimulationError as error:
        return str(error)
    return ""

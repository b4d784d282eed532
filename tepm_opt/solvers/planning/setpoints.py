"""Set points that make planned forces: pressures ahead of the regulators and on their grid, tensions for what they leave; their check."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.devices import Devices
from tepm_opt.solvers.kinematics.allocation import axial_forces
from tepm_opt.solvers.linear.modal_model import modal_model
from tepm_opt.solvers.mechanics.simulate import SimulationError, simulate
from tepm_opt.solvers.mechanics.statics import Equilibrium

SUBSTEP = 1e-3  # s, of the regulators between the set points
WATCHED, ROW = 5.0, 0.02  # s: for how long the tip is watched after the end, and how often
MANY, WAYS = 12, 4000  # forces whose signs are all tried; directions that tell the signs of more
STEP = 0.01  # s, of simulations; fixed, so that small changes of a plan change its sway smoothly


@dataclass(frozen=True)
class Friction:
    """Friction by which a tendon's end may pull more or less than its motor: a force that is bounded and otherwise unknown.

    Attributes:
        constant: part in N.
        share: of the tension.
    """

    constant: float
    share: float

    @staticmethod
    def from_model(model: CompiledModel, doubt: float) -> Friction:
        """Friction of a model, with an additional share of the tension for doubt."""
        constant, share = model.tendon_friction or (0.0, 0.0)
        return Friction(constant, share + doubt)

    def offset(self, at: Equilibrium, tension: np.ndarray) -> float:
        """Largest distance in m by which it may hold the tip from an equilibrium with tensions (modules · 3,) in N, to first order."""
        gain, forces = modal_model(at, modes=1).gain[-3:], self.constant + self.share * tension
        if len(forces) <= MANY:
            signs = np.array(list(itertools.product((-1.0, 1.0), repeat=len(forces))))
        else:  # those that are farthest along some direction
            signs = np.sign(np.random.default_rng(0).normal(size=(WAYS, 3)) @ (gain * forces))
        return float(np.linalg.norm((signs * forces) @ gain.T, axis=1).max())


def tensions(model: CompiledModel, pressures: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Tensions (modules · 3,) in N that make axial forces with these pressures in the muscles; may leave the limits."""
    tension = model.values["A"] * pressures - forces
    for _ in range(20):  # effects bend the way from set points to forces a little
        missing = forces - axial_forces(model, np.concatenate([pressures, tension]))
        tension = tension - missing
        if np.abs(missing).max() < 1e-10:
            break
    return tension


def commands(
    model: CompiledModel, ahead: np.ndarray, wanted: np.ndarray, time: np.ndarray, devices: Devices
) -> tuple[np.ndarray, np.ndarray]:
    """Pressures to command on the regulators' grid, and what they make in the muscles, both (rows, modules · 3) in Pa.

    What rounding one row missed is carried to the next, so that the muscles, which average over many rows, hardly notice the grid.

    Args:
        model: whose grid and limits.
        ahead: commands before rounding, (rows, modules · 3) in Pa.
        wanted: pressures in the muscles that they are for; the last ones are commanded as they are.
        time: of the rows, (rows,) in s.
        devices: the regulators.
    """
    half = wanted.shape[1]
    highest, carried = model.input_max[:half], np.zeros(half)
    given, muscle = wanted.copy(), wanted.copy()
    for row in range(1, len(time)):
        if row < len(time) - 1:
            ideal = np.clip(ahead[row] + carried, 0.0, highest)
            given[row] = model.robot.actuation.pressures_on_grid(ideal)
            carried = ideal - given[row]
        muscle[row] = _apply_lag(muscle[row - 1], given[row - 1], given[row], time[row] - time[row - 1], devices)
    return given, muscle


def _apply_lag(pressure: np.ndarray, before: np.ndarray, after: np.ndarray, duration: float, devices: Devices) -> np.ndarray:
    """Pressure in the muscles after commands that go linearly from `before` to `after`."""
    steps = max(1, round(duration / SUBSTEP))
    for part in (np.arange(steps) + 0.5) / steps:
        pressure = devices.lag(pressure, before + part * (after - before), duration / steps)
    return pressure


def residual_sway(model: CompiledModel, time: np.ndarray, muscle: np.ndarray, tension: np.ndarray, rest: np.ndarray) -> float:
    """Largest distance in m of the tip from its rest (3,) in the 5 s after the last row, in a simulation of the full network.

    Args:
        model: the network; regulators are what comes before these pressures, so it should have none of its own.
        time: of the rows, (rows,) in s; stretched, it is that of an arm whose frequencies are as much higher.
        muscle: pressures in the muscles, (rows, modules · 3) in Pa.
        tension: (rows, modules · 3) in N.
        rest: of the tip in G, m.
    """
    inputs = np.clip(np.hstack([muscle, tension]), 0.0, model.input_max)
    after = time[-1] + np.arange(1, round(WATCHED / ROW) + 1) * ROW
    inputs = np.vstack([inputs, np.repeat(inputs[-1:], len(after), axis=0)])
    try:
        motion = simulate(model, SetPoints(np.concatenate([time, after]), inputs, np.zeros((len(inputs), 3))), step=STEP).complete()
    except (SimulationError, InputError):
        return np.inf
    return float(np.linalg.norm(motion.tip[len(time) - 1 :] - rest, axis=1).max())

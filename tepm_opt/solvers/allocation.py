"""From axial forces to set points: which part is pressure, which part is tension (F_a = p A - lambda, Eq. (3))."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.choices import ActuationMode

PRECISION = 1e-10  # N
ITERATIONS = 200


@dataclass(frozen=True, eq=False)
class Allocation:
    """Set points for axial forces.

    Attributes:
        inputs: u, (2 · modules · actuators,) in Pa and N; in hybrid mode the pressures are on the regulator's grid.
        rounded: u with both actuators on their grids.
        error: largest axial force that the inputs miss in N (0 where the forces are within the limits).
    """

    inputs: np.ndarray
    rounded: np.ndarray
    error: float

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Allocation({len(self.inputs)} inputs, misses axial forces by at most {self.error:.3g} N)"


def axial_forces(model: CompiledModel, inputs: np.ndarray) -> np.ndarray:
    """Axial forces F_a (modules · actuators,) in N under inputs, through the effects' input maps."""
    effective = model.statics.actuation(inputs, model.theta)
    half = len(effective) // 2
    return model.values["A"] * effective[:half] - effective[half:]


def force_range(model: CompiledModel, mode: ActuationMode) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest axial forces (modules · actuators,) in N that a mode can make with all actuators alike."""
    half, limit = model.layout.inputs // 2, model.input_max
    full_pressure, full_tension = limit.copy(), limit.copy()
    full_pressure[half:], full_tension[:half] = 0.0, 0.0
    if mode is ActuationMode.PRESSURE:
        return axial_forces(model, 0 * limit), axial_forces(model, full_pressure)
    return axial_forces(model, full_tension), axial_forces(model, model.robot.actuation.on_grid(full_pressure))


def allocate(model: CompiledModel, forces: np.ndarray, mode: ActuationMode, mid_tension: float | None = None) -> Allocation:
    """Set points that make the axial forces.

    Effects bend the way from set points to forces, so it is inverted by iterating with the nominal one, F_a = p A - lambda;
    that contracts as long as effects change forces by less than their own size.

    Args:
        model: compiled model.
        forces: F_a, (modules · actuators,) in N.
        mode: pressure or hybrid.
        mid_tension: tension about which the hybrid mode keeps its authority, N; the middle of the range where absent.
    """
    area, limit, half = model.values["A"], model.input_max, len(forces)
    inputs = np.zeros(2 * half)
    if mode is ActuationMode.HYBRID:
        inputs[half:] = limit[half:] / 2 if mid_tension is None else mid_tension
    _correct(model, inputs, forces, slice(0, half), 1 / area)
    if mode is ActuationMode.HYBRID:
        inputs[:half] = model.robot.actuation.pressures_on_grid(inputs[:half])
        _correct(model, inputs, forces, slice(half, None), -1.0)
    error = float(np.abs(forces - axial_forces(model, inputs)).max())
    return Allocation(inputs, model.robot.actuation.on_grid(inputs), error)


def _correct(model: CompiledModel, inputs: np.ndarray, forces: np.ndarray, part: slice, gain: float) -> None:
    """Change one part of the inputs in place, within limits, until the forces are met or nothing moves.

    Where an input does not answer (a dead zone), its steps double until it does.
    """
    boost, before = np.ones(len(forces)), np.full(len(forces), np.inf)
    for _ in range(ITERATIONS):
        missing = forces - axial_forces(model, inputs)
        if np.abs(missing).max() < PRECISION:
            return
        unanswered = (np.abs(missing) > 0.9 * np.abs(before)) & (np.sign(missing) == np.sign(before))  # what was overshot did answer
        boost = np.where(unanswered, 2 * boost, 1.0)
        before = missing
        changed = np.clip(inputs[part] + gain * boost * missing, 0.0, model.input_max[part])
        moved = np.abs(changed - inputs[part]).max() / abs(gain)
        inputs[part] = changed
        if moved < PRECISION:
            return

"""From axial forces to set points: which part is pressure, which part is tension (F_a = p A - lambda, Eq. (3))."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tepm_opt.models.backends.interface import Allotment
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode


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


def allotment(model: CompiledModel, mode: ActuationMode, mid_tension: float | None = None) -> Allotment:
    """Rule by which a mode makes axial forces; see `allocate`."""
    start, half = np.zeros(model.layout.inputs), model.layout.inputs // 2
    hybrid = mode is ActuationMode.HYBRID
    if hybrid:
        start[half:] = model.input_max[half:] / 2 if mid_tension is None else mid_tension
    return Allotment(model.values["A"], start, model.input_max, model.input_step, hybrid)


def allocate(model: CompiledModel, forces: np.ndarray, mode: ActuationMode, mid_tension: float | None = None) -> Allocation:
    """Set points that make the axial forces, through the effects' input maps.

    Args:
        model: compiled model.
        forces: F_a, (modules · actuators,) in N.
        mode: pressure or hybrid.
        mid_tension: tension about which the hybrid mode keeps its authority, N; the middle of the range where absent.
    """
    return Allocation(*model.statics.allocate(forces, allotment(model, mode, mid_tension), model.theta))

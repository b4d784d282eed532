"""What no plan can be faster than: the shortest motion of the arm linearised between its ends, a linear program for each duration."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm
from scipy.optimize import linprog

from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.devices import Devices
from tepm_opt.solvers.kinematics.ik import Configuration
from tepm_opt.solvers.linear.modal_model import ModalModel

STEPS = 40


def reachable(
    local: ModalModel,
    ends: tuple[Configuration, Configuration],
    devices: Devices,
    lag: float,
    tensions: tuple[float, float],
    duration: float,
) -> bool:
    """Whether the linear arm comes from rest to rest, all its modes, in a duration.

    Commands of pressure are constant from step to step and forces linear; the pressure in a muscle lags with one time constant, filling or
    emptying, as a linear arm must have it.

    Args:
        local: modal model between the ends.
        ends: whose inputs are held before and after.
        devices: rate of the motors.
        lag: of the regulators, s.
        tensions: smallest and largest on the way, N.
        duration: s.
    """
    model, half, modes = local.equilibrium.model, local.drive.shape[1], len(local.stiffness)
    area, highest = model.values["A"], model.input_max[:half]
    inputs = np.array([end.allocation.inputs for end in ends])
    air, tension, h = area * inputs[:, :half], inputs[:, half:], duration / STEPS
    arm = np.zeros((2 * modes + 2 * half,) * 2)  # states, forces at the step's begin, their rate: forces are linear over a step
    arm[:modes, modes : 2 * modes] = np.eye(modes)
    arm[modes : 2 * modes, :modes], arm[modes : 2 * modes, modes : 2 * modes] = -np.diag(local.stiffness), -local.damping
    arm[modes : 2 * modes, 2 * modes : 2 * modes + half] = local.drive
    arm[2 * modes : 2 * modes + half, 2 * modes + half :] = np.eye(half)
    step = expm(arm * h)[: 2 * modes]
    along, begin, slope = step[:, : 2 * modes], step[:, 2 * modes : 2 * modes + half], step[:, 2 * modes + half :] / h
    # unknowns: forces of the air P and tensions, at steps 0 … STEPS, one step after the other
    count = half * (STEPS + 1)
    by = np.zeros((2 * modes, count))
    for k in range(STEPS):
        by = along @ by
        by[:, half * k : half * (k + 1)] += begin - slope
        by[:, half * (k + 1) : half * (k + 2)] += slope
    held = air - tension
    rests = np.linalg.matrix_power(along, STEPS) @ np.concatenate([(local.drive @ held[0]) / local.stiffness, np.zeros(modes)])
    wanted = np.concatenate([(local.drive @ held[1]) / local.stiffness, np.zeros(modes)]) - rests
    scale = np.concatenate([np.ones(modes), 1 / np.sqrt(local.stiffness)])[:, None]
    forward = np.kron(np.eye(STEPS, STEPS + 1, 1), np.eye(half))
    now = np.kron(np.eye(STEPS, STEPS + 1), np.eye(half))
    fading = np.exp(-h / lag)
    command = (forward - fading * now) / (1 - fading)
    none = np.zeros_like(command)
    rows = np.vstack(
        [np.hstack([command, none]), np.hstack([-command, none]), np.hstack([none, forward - now]), np.hstack([none, now - forward])]
    )
    most = np.tile(area * highest, STEPS)
    rate = np.full(half * STEPS, devices.tension_rate * h)
    bounds = np.concatenate([np.tile([[-np.inf, np.inf]], (count, 1)), np.tile([tensions], (count, 1))])
    for at, row in ((0, 0), (STEPS, 1)):
        bounds[half * at : half * (at + 1)] = air[row][:, None]
        bounds[count + half * at : count + half * (at + 1)] = tension[row][:, None]
    found = linprog(
        np.zeros(2 * count), A_ub=rows, b_ub=np.concatenate([most, 0 * most, rate, rate]), A_eq=scale * np.hstack([by, -by]),
        b_eq=scale[:, 0] * wanted, bounds=bounds, method="highs-ds",
    )  # fmt: skip
    return found.status == 0


def lowest_time(
    local: ModalModel, ends: tuple[Configuration, Configuration], devices: Devices, lag: float, tensions: tuple[float, float]
) -> float:
    """The shortest duration within 2 %, s; see `reachable` for the arguments."""
    low, high = 0.05, 2.0
    while high > 1.02 * low:
        middle = np.sqrt(low * high)
        if reachable(local, ends, devices, lag, tensions, middle):
            high = middle
        else:
            low = middle
    return float(high)


def between(model: CompiledModel, ends: tuple[Configuration, Configuration]) -> np.ndarray:
    """Inputs in the middle of those of two ends."""
    return (ends[0].allocation.inputs + ends[1].allocation.inputs) / 2

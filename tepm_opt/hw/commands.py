"""Checks of a command that every rig makes before it carries it out."""

from __future__ import annotations

import numpy as np

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Command
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot

_ROUNDING = 1e-9  # relative to the limit: what is lost in writing a set point down


def check_command(command: Command, robot: Robot) -> np.ndarray:
    """[pressures, tensions, ENA] of a command, (3 · modules · actuators,) in Pa, N and 0 or 1.

    Raises:
        InputError: wrong number of values, a value that is NaN or outside the robot's limits; names the actuator and what is valid.
    """
    count = robot.modules * robot.actuators
    for kind in ("pressures", "tensions", "enabled"):
        shape = np.shape(getattr(command, kind))
        if shape != (count,):
            names = ", ".join(Layout.from_robot(robot).actuator_names)
            raise InputError(f"command: {kind} has the shape {shape}; valid: ({count},) for the actuators {names}")
    enabled = np.asarray(command.enabled)
    if enabled.dtype != bool:
        raise InputError("command: enabled has to be true or false for each actuator")
    checked = np.concatenate([command.pressures, command.tensions, enabled]).astype(float, copy=False)
    checked[: 2 * count] = _clip_rounding(checked[None, : 2 * count], robot)
    return checked


def _clip_rounding(values: np.ndarray, robot: Robot) -> np.ndarray:
    """Clip inputs (rows, 2 · modules · actuators) that rounding puts beyond the robot's limits.

    Raises:
        InputError: a value is NaN or outside the limits.
    """
    limits = robot.input_max
    wrong = ~((values >= -_ROUNDING * limits) & (values <= limits * (1 + _ROUNDING)))  # NaN is wrong, too
    if wrong.any():
        row, first = (int(at[0]) for at in np.nonzero(wrong))
        names = Layout.from_robot(robot).actuator_names
        kind, unit = ("pressure", "Pa") if first < len(names) else ("tension", "N")
        found = f"{kind} of actuator {names[first % len(names)]} = {values[row, first]:g} {unit}"
        raise InputError(f"command: {found}; valid: 0 … {limits[first]:g} {unit}")
    return np.minimum(np.maximum(values, 0.0), limits)


def check_setpoints(setpoints: SetPoints, robot: Robot) -> np.ndarray:
    """[pressures, tensions, ENA] of every row with all motors enabled, (rows, 3 · modules · actuators) in Pa, N and 1.

    Raises:
        InputError: a value that is NaN or outside the robot's limits, or a tip force that is not finite.
    """
    check_command(Command.from_inputs(setpoints.inputs[0]), robot)  # how many there are
    values = np.column_stack([_clip_rounding(setpoints.inputs, robot), np.ones((len(setpoints.inputs), setpoints.inputs.shape[1] // 2))])
    if not np.isfinite(setpoints.tip_force).all():
        raise InputError("set points: a tip force is not a finite number")
    return values

"""What every rig checks before it carries out a command."""

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
    names = Layout.of(robot).actuator_names
    count = len(names)
    for kind in ("pressures", "tensions", "enabled"):
        shape = np.shape(getattr(command, kind))
        if shape != (count,):
            raise InputError(f"command: {kind} has the shape {shape}; valid: ({count},) for the actuators {', '.join(names)}")
    if np.asarray(command.enabled).dtype != bool:
        raise InputError("command: enabled has to be true or false for each actuator")
    values = np.concatenate([command.pressures, command.tensions]).astype(float)
    limits = robot.input_max
    wrong = ~((values >= -_ROUNDING * limits) & (values <= limits * (1 + _ROUNDING)))  # NaN is wrong, too
    if wrong.any():
        first = int(np.argmax(wrong))
        kind, unit = ("pressure", "Pa") if first < count else ("tension", "N")
        raise InputError(
            f"command: {kind} of actuator {names[first % count]} = {values[first]:g} {unit}; valid: 0 … {limits[first]:g} {unit}"
        )
    return np.concatenate([np.clip(values, 0.0, limits), np.asarray(command.enabled, dtype=float)])


def check_setpoints(setpoints: SetPoints, robot: Robot) -> np.ndarray:
    """[pressures, tensions, ENA] of every row with all motors enabled, (rows, 3 · modules · actuators) in Pa, N and 1.

    Raises:
        InputError: a value that is NaN or outside the robot's limits, or a tip force that is not finite.
    """
    values = np.array([check_command(Command.of(row), robot) for row in setpoints.inputs])
    if not np.isfinite(setpoints.tip_force).all():
        raise InputError("set points: a tip force is not a finite number")
    return values

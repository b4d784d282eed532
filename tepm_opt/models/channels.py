"""Channels of data about a robot, taken from its file; data sets read with the robot they name."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tepm_opt.data.channels import Channels
from tepm_opt.data.checks.dataset import check_reading
from tepm_opt.data.checks.findings import Finding
from tepm_opt.data.datasets import DataSet, FolderReading, read_folder
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot, load_robot

PAPER = 1.392  # Hz, `_sway` of the paper's robot, on which limits of speed are founded


def channels_of(robot: Robot) -> Channels:
    """Names and magnitudes of the quantities in a robot's data."""
    layout = Layout.from_robot(robot)
    x, y, z = (float(value) for value in robot.mount.rotation[:, 2])
    return Channels(
        layout.actuator_names,
        layout.point_names,
        robot.actuation.pressure_max_Pa,
        robot.actuation.tension_max_N,
        robot.modules * robot.parameters.L_0,
        robot.mount.base_position_m,
        (x, y, z),
        _sway(robot) / PAPER,
    )


def _sway(robot: Robot) -> float:
    """Rough frequency of a robot's sway in Hz: a beam of muscles without weight, clamped below; 3 EI / h³ over 0.24 of its mass."""
    value, height = robot.parameters, robot.modules * robot.parameters.L_0
    bending = robot.actuators / 2 * value.K_a * value.L_0 * value.r**2
    return float(np.sqrt(3 * bending / height**3 / (0.24 * robot.modules * value.m_d)) / (2 * np.pi))


def read(folder: str | Path) -> FolderReading:
    """All that can be read of a data set, with the columns, the limits and the size of the robot that it names.

    Raises:
        InputError: no folder, no `dataset.toml`, or one that is not TOML.
    """
    return read_folder(folder, lambda robot: channels_of(load_robot(robot)))


def open_dataset(folder: str | Path) -> DataSet:
    """A data set with the columns of the robot that it names.

    Raises:
        InputError: as for `read_dataset` and `load_robot`.
    """
    return read(folder).usable


def check(folder: str | Path) -> list[Finding]:
    """Find what is wrong or doubtful in a data set's folder, by limits and size of the robot it names.

    Raises:
        InputError: no folder, no `dataset.toml`, or one that is not TOML.
    """
    return check_reading(read(folder))

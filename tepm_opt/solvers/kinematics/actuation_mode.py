"""Actuators by which axial forces are made, as a person chooses them; imports nothing, so that the command line starts at once."""

from __future__ import annotations

from enum import StrEnum


class ActuationMode(StrEnum):
    """Actuators that make the axial forces."""

    PRESSURE = "pressure"
    """The paper's mode 1: the tendons are slack."""
    HYBRID = "hybrid"
    """Pressure on the regulator's grid, tension takes the rest about its mid-range."""

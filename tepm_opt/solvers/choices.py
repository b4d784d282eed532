"""Names by which a person chooses; they import nothing, so that the command line starts at once."""

from __future__ import annotations

from enum import StrEnum


class ActuationMode(StrEnum):
    """Actuators that make the axial forces."""

    PRESSURE = "pressure"
    """The paper's mode 1: the tendons are slack."""
    HYBRID = "hybrid"
    """Pressure on the regulator's grid, tension takes the rest about its mid-range."""


class Objective(StrEnum):
    """Quantity that a plan minimises."""

    TIME = "time"
    EFFORT = "effort"
    """Integral of the squared rates of all set points, pressures as p A, in N²/s; in a given duration."""

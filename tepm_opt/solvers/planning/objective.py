"""Objectives of plans, as a person chooses them; imports nothing, so that the command line starts at once."""

from __future__ import annotations

from enum import StrEnum


class Objective(StrEnum):
    """Quantity that a plan minimises."""

    TIME = "time"
    EFFORT = "effort"
    """Integral of the squared rates of all set points, pressures as p A, in N²/s; in a given duration."""

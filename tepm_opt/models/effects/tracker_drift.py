"""A tracker whose pose drifts."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import CLOCK, Context, Effect, Parameter
from tepm_opt.models.effects.rotations import rotation


class TrackerDrift(Effect):
    """The tracker's frame turns about the origin of G and shifts at constant rates from the session's start.

    A session is short beside what makes a tracker drift, so that rates are all that shows; where it was at the start is a misalignment.
    Rates of rotation are those of `sensor_misalignment`'s angles. At rest the clock stands still, by default at the session's start.
    """

    name = "tracker_drift"
    explains = "the tracker's pose drifts over the session"
    reference = "first-order drift of a zero; Doebelin, Measurement Systems, 4th ed., 1990, section 3.3"
    timed = True
    parameters = (
        *(Parameter(f"rotation_{axis}", "rad/s", null=0.0, probe=2e-5, low=-0.01, high=0.01) for axis in "xyz"),
        *(Parameter(f"shift_{axis}", "m/s", null=0.0, probe=1e-5, low=-0.01, high=0.01) for axis in "xyz"),
    )

    def outputs(self, points: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        turn, shift = ([parameters[f"{part}_{axis}"] * parameters[CLOCK] for axis in "xyz"] for part in ("rotation", "shift"))
        return rotation(*turn) @ points + ca.repmat(ca.vertcat(*shift), 1, context.layout.points)

"""A tracker whose pose drifts."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import CLOCK, Context, Effect, Parameter
from tepm_opt.models.effects.rotations import rotation

SMALL = 1e-3  # exponents below it are expanded to the third order


class TrackerDrift(Effect):
    """The tracker's frame turns about the origin of G and shifts from the session's start on.

    Rates of rotation and shift are those at the start; they decay exponentially, as a tracker's do that warms up, or stay as they are
    where `decay` is 0. A negative one speeds the drift up. Where the frame was at the start is a misalignment; angles are those of
    `sensor_misalignment`. At rest the clock stands still, by default at the session's start.
    """

    name = "tracker_drift"
    explains = "the tracker's pose drifts over the session"
    reference = "first-order drift of a zero; Doebelin, Measurement Systems, 4th ed., 1990, section 3.3"
    timed = True
    parameters = (
        *(Parameter(f"rotation_{axis}", "rad/s", null=0.0, probe=2e-5, low=-0.01, high=0.01) for axis in "xyz"),
        *(Parameter(f"shift_{axis}", "m/s", null=0.0, probe=1e-5, low=-0.01, high=0.01) for axis in "xyz"),
        Parameter("decay", "1/s", null=0.0, probe=0.0, low=-0.005, high=0.1, change=2e-3),
    )

    def outputs(self, points: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        lasted = _integrate_decay(parameters["decay"], parameters[CLOCK])
        turn, shift = ([parameters[f"{part}_{axis}"] * lasted for axis in "xyz"] for part in ("rotation", "shift"))
        return rotation(*turn) @ points + ca.repmat(ca.vertcat(*shift), 1, context.layout.points)


def _integrate_decay(decay: ca.SX, time: ca.SX) -> ca.SX:
    """The integral of exp(-decay t) from 0 to a time: the time itself without decay."""
    exponent = decay * time
    is_small = ca.fabs(exponent) < SMALL
    long = -ca.expm1(-exponent) / ca.if_else(is_small, 1.0, exponent)
    return time * ca.if_else(is_small, 1 - exponent / 2 * (1 - exponent / 3 * (1 - exponent / 4)), long)

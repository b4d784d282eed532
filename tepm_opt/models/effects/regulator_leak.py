"""One valve, or muscle, that leaks."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter

ATMOSPHERE = 101_325.0  # Pa
CRITICAL_RATIO = 0.35  # where nothing else is known; small holes have 0.2 to 0.5
LAMINAR = 0.1  # of the choked flow, below which it goes with the pressure, not with its root
STEPS = 5  # of Newton's method


class RegulatorLeak(Effect):
    """One muscle's pressure falls short by a share of its absolute pressure where the leak's flow is choked, by less below, by 0 at none.

    The regulator fills in proportion to the error, the leak is an orifice to the atmosphere; the share is the orifice's conductance over
    the regulator's. Its flow is choked below the `critical_ratio` of the absolute pressures. Both flows are equal at the pressure found.
    """

    name = "regulator_leak"
    of_device = True
    explains = "one valve or muscle leaks"
    reference = "orifice of ISO 6358-1:2013, with a laminar beginning"
    detail = "actuator"
    parameters = (
        Parameter("share", "1", null=0.0, probe=0.02, low=0.0, high=0.5),
        Parameter("critical_ratio", "1", null=CRITICAL_RATIO, probe=CRITICAL_RATIO, low=0.05, high=0.6, finer=True),
    )

    def inputs(self, pressure: ca.SX, tension: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> tuple[ca.SX, ca.SX]:
        at = divmod(context.detail or 0, context.layout.actuators)
        commanded, share, flow = pressure[at], parameters["share"], _orifice()
        inside = commanded
        for _ in range(STEPS):
            passed, slope = flow(inside, parameters["critical_ratio"])
            inside = ca.fmax(inside - (inside + share * passed - commanded) / (1 + share * slope), 0)
        less = ca.SX(pressure)
        less[at] = commanded - share * flow(inside, parameters["critical_ratio"])[0]
        return less, tension


@cache
def _orifice() -> ca.Function:
    """Flow over the orifice's conductance in Pa, and its derivative, of the gauge pressure before it in Pa and the critical ratio."""
    pressure, critical = ca.SX.sym("pressure"), ca.SX.sym("critical_ratio")
    inside = ca.fmax(pressure, 0) + ATMOSPHERE
    squared = 1 - (ca.fmax(ATMOSPHERE / inside - critical, 0) / (1 - critical)) ** 2  # flow over the choked one's, by the standard
    flow = inside * squared * ca.sqrt((1 + LAMINAR**2) / (squared + LAMINAR**2))
    return ca.Function("orifice", [pressure, critical], [flow, ca.gradient(flow, pressure)])

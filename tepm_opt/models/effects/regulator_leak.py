"""One valve, or muscle, that leaks."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter

ATMOSPHERE = 101_325.0  # Pa
CRITICAL_RATIO = 0.35  # where nothing else is known; small holes have 0.2 to 0.5
LAMINAR = 1e-3  # of the choked flow, below which it does not go with the pressure's root


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
        commanded = ca.fmax(pressure[at], 0) + ATMOSPHERE
        less = ca.SX(pressure)
        less[at] = pressure[at] - lost_pressure(commanded, parameters["share"], parameters["critical_ratio"])
        return less, tension


def lost_pressure(commanded: ca.SX, share: ca.SX, critical: ca.SX) -> ca.SX:
    """Pressure that a leak takes of an absolute one, both in Pa, where the flows of regulator and leak are equal.

    Below the choked flow, an ellipse of the pressure, this is the smaller root of a quadratic equation; above, a share of the pressure.
    """
    least = ca.fmin(commanded, (1 + share) * ATMOSPHERE / critical)
    width = 1 - critical
    ellipse = (width * least) ** 2 - (ATMOSPHERE - critical * least) ** 2
    flow = ca.sqrt(ellipse + ((share + LAMINAR) * ATMOSPHERE) ** 2) - LAMINAR * ATMOSPHERE
    inside = width**2 * least + share**2 * critical * ATMOSPHERE - share * width * flow
    return least - inside / (width**2 - share**2 * (1 - 2 * critical)) + share / (1 + share) * (commanded - least)

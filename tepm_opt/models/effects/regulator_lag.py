"""Pressure regulators that take time to fill and to empty a muscle."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter
from tepm_opt.models.memories import Lag, Saturating

LOOK_AHEAD = 1e-6  # s; looks this far ahead to see whether a muscle fills or empties
ATMOSPHERE = 101_325.0  # Pa
LAMINAR = 0.1  # of the atmosphere, keeps the flow out of a muscle above 0 where nothing drives it any more


class RegulatorLag(Effect):
    """First-order lag with a time constant for filling and one for exhausting: y = pressure in the muscle less pressure commanded.

    A valve opens in proportion to y up to `opening`, then no further, and its flow chokes:
    dy/dt = -y / (time + choke max(|y| - opening, 0)). A valve that does nothing but choke has choke times opening as time constant, and
    pressure changes by no more than 1 / choke. On the way down both go with the flow out of the muscle, sqrt(P² - P_a²) of the absolute
    pressures, and are those at 125 kPa (gauge), where it is twice the atmosphere.
    """

    name = "regulator_lag"
    of_device = True
    explains = "the regulators fill and empty with a time constant"
    reference = "Richer and Hurmuzlu, A high performance pneumatic force actuator system, ASME JDSMC 122 (2000), small signals"
    parameters = (
        Parameter("filling_time", "s", null=0.0, probe=0.05, low=0.0, high=10.0),
        Parameter("exhausting_time", "s", null=0.0, probe=0.05, low=0.0, high=10.0),
        Parameter("filling_choke", "s/Pa", null=0.0, probe=0.0, low=0.0, high=1e-3, change=5e-7),
        Parameter("exhausting_choke", "s/Pa", null=0.0, probe=0.0, low=0.0, high=1e-3, change=5e-7),
        Parameter("opening", "Pa", null=1e4, probe=1e4, low=0.0, high=1e5, finer=True),
    )
    further_probes = ({"filling_time": 1.0, "exhausting_time": 1.0},)
    further_shapes = ({"filling_choke": 1e-6, "exhausting_choke": 1e-6},)  # valves that choke from small steps on

    def lag(self, parameters: Mapping[str, ca.SX]) -> Lag:
        return Lag(parameters["filling_time"], parameters["exhausting_time"])

    def pressure_memory(self, pressure: ca.SX, rate: ca.SX, state: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> Saturating:
        lag = self.lag(parameters)
        filling = state - LOOK_AHEAD * rate < 0

        def slow_down(state: ca.SX, left: ca.SX) -> ca.SX:
            inside = ca.fmax(pressure - left * rate + state, 0) + ATMOSPHERE
            outflow = ca.sqrt(inside**2 - (1 - LAMINAR**2) * ATMOSPHERE**2) / (2 * ATMOSPHERE)
            return ca.if_else(filling, parameters["filling_choke"], parameters["exhausting_choke"] / outflow)

        times, opening = ca.if_else(filling, lag.filling, lag.exhausting), parameters["opening"]
        choke = ca.if_else(filling, parameters["filling_choke"], parameters["exhausting_choke"])
        return Saturating(-rate, ca.SX.ones(*state.shape), times - choke * opening, slow_down, opening)

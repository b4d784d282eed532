"""Pressure regulators that take time to fill and to empty a muscle."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Lag, Memory, Parameter

LOOK_AHEAD = 1e-6  # s; looks this far ahead to see whether a muscle fills or empties


class RegulatorLag(Effect):
    """First-order lag with a time constant for filling and one for exhausting: y = pressure in the muscle less pressure commanded."""

    name = "regulator_lag"
    explains = "the regulators fill and empty with a time constant"
    reference = "Richer and Hurmuzlu, A high performance pneumatic force actuator system, ASME JDSMC 122 (2000), small-signal form"
    parameters = (
        Parameter("filling_time", "s", null=0.0, probe=0.05, low=0.0, high=10.0),
        Parameter("exhausting_time", "s", null=0.0, probe=0.05, low=0.0, high=10.0),
    )

    def lag(self, parameters: Mapping[str, ca.SX]) -> Lag:
        return Lag(parameters["filling_time"], parameters["exhausting_time"])

    def pressure_memory(
        self, pressure: ca.SX, rate: ca.SX, state: ca.SX, parameters: Mapping[str, ca.SX], context: Context
    ) -> Memory | None:
        lag = self.lag(parameters)
        filling = state - LOOK_AHEAD * rate < 0
        return Memory(-rate, ca.SX.ones(*state.shape), ca.if_else(filling, lag.filling, lag.exhausting))

"""Muscle force that lags pressure reversals whatever their rate."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter
from tepm_opt.models.memories import Memory


class PressureHysteresis(Effect):
    """Bouc-Wen with exponent 1: effective pressure trails by `width` after travelling some `distance` since the last reversal.

    On the way down it is above by `falling_ratio` times the width that it is below on the way up. A run begins on the curve of a muscle
    filled from zero where `filled` is 1, as far above the middle where it is -1.
    """

    name = "pressure_hysteresis"
    explains = "the muscles' force lags pressure reversals, independent of rate"
    reference = "Bouc-Wen, exponent 1 (Dahl's form); Ikhouane and Rodellar, Systems with Hysteresis, 2007, ch. 2"
    parameters = (
        Parameter("width", "Pa", null=0.0, probe=5e3, low=0.0, high=1e6),
        Parameter("distance", "Pa", null=2e4, probe=2e4, low=1.0, high=1e6),
        Parameter("falling_ratio", "1", null=1.0, probe=1.0, low=0.0, high=10.0),
        Parameter("filled", "1", null=0.0, probe=0.0, low=-1.0, high=1.0, change=0.3),
    )
    further_probes = ({"distance": 5e3},)

    def pressure_begun(self, pressure: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        travelled = ca.fabs(pressure) / parameters["distance"]
        return parameters["filled"] * parameters["width"] * ca.expm1(-travelled)

    def pressure_memory(
        self, pressure: ca.SX, rate: ca.SX, state: ca.SX, parameters: Mapping[str, ca.SX], context: Context
    ) -> Memory | None:
        width, distance = parameters["width"] * ca.if_else(rate > 0, 1, parameters["falling_ratio"]), parameters["distance"]
        return Memory(-width / distance * rate, ca.fabs(rate), distance * ca.SX.ones(*state.shape))

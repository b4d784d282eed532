"""Muscle force that lags pressure reversals whatever their rate."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter
from tepm_opt.models.memories import Play

WIDER = (-1, 0, 1)  # times `spread`, by which each of the plays is wider


class PressureHysteresis(Effect):
    """Effective pressure trails by `width` after travelling some `distance` since the last reversal.

    Three plays beside each other share it (Prandtl-Ishlinskii), one narrower and one wider by a part `spread`, in width and distance:
    reversals within reversals are then remembered. Without `sticking` what is left to where they trail fades exponentially (Bouc-Wen with
    exponent 1), with 1 it is a play with a round corner, the force at first staying where it is (see `memories.Play`). On the way down it
    is above by `falling_ratio` times the width that it is below on the way up. A run begins on the curve of a muscle filled from zero
    where `filled` is 1, as far above the middle where it is -1.
    """

    name = "pressure_hysteresis"
    explains = "the muscles' force lags pressure reversals, independent of rate"
    reference = "Bouc-Wen; Ikhouane and Rodellar, Systems with Hysteresis, 2007, ch. 2; plays: Brokate and Sprekels, 1996, ch. 2"
    branches = len(WIDER)
    parameters = (
        Parameter("width", "Pa", null=0.0, probe=5e3, low=0.0, high=1e6),
        Parameter("distance", "Pa", null=2e4, probe=2e4, low=50.0, high=1e6),
        Parameter("falling_ratio", "1", null=1.0, probe=1.0, low=0.0, high=10.0),
        Parameter("filled", "1", null=0.0, probe=0.0, low=-1.0, high=1.0, change=0.3),
        Parameter("sticking", "1", null=0.0, probe=0.0, low=0.0, high=4.0, change=0.3),
        Parameter("spread", "1", null=0.5, probe=0.5, low=0.0, high=0.95, change=0.3, finer=True),
    )
    further_probes = ({"distance": 5e3},)

    def pressure_begun(self, pressure: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        play = self._play(ca.fabs(pressure), ca.SX.ones(*pressure.shape), parameters, context)
        return parameters["filled"] * play.advance(ca.SX.zeros(*pressure.shape), ca.SX(1))

    def pressure_memory(self, pressure: ca.SX, rate: ca.SX, state: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> Play:
        return self._play(rate, rate > 0, parameters, context)

    def hysteresis(self, parameters: Mapping[str, ca.SX]) -> ca.SX:
        return parameters["width"] * (1 + parameters["falling_ratio"]) / 2

    def _play(self, rate: ca.SX, rising: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> Play:
        scales = ca.vertcat(*(ca.repmat(1 + by * parameters["spread"], context.layout.modules, rate.shape[1]) for by in WIDER))
        limit = parameters["width"] * scales / len(WIDER) * ca.if_else(rising, -1, parameters["falling_ratio"])
        pace, distance = ca.if_else(rising, rate, -rate) / len(WIDER), parameters["distance"] * scales / len(WIDER)
        return Play(limit, rising, pace, distance, parameters["sticking"])

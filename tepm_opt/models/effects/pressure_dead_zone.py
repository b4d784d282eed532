"""Muscles that give no force until a threshold pressure."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter
from tepm_opt.models.effects.corners import ROUNDING, subtract_threshold


class PressureDeadZone(Effect):
    """Effective pressure max(p - threshold, 0), its corner rounded by a parabola so that the gain is continuous.

    `rounding` is the corner's half-width over the threshold. Above 1 the muscle gives some force from the beginning on, but none
    without pressure.
    """

    name = "pressure_dead_zone"
    explains = "no force until a threshold pressure"
    reference = "Tao and Kokotović, Adaptive Control of Systems with Actuator and Sensor Nonlinearities, 1996, ch. 2"
    smooth = False  # at no threshold and no pressure the derivative by the threshold has a jump
    parameters = (
        Parameter("threshold", "Pa", null=0.0, probe=5e3, low=0.0, high=1e6),
        Parameter("rounding", "1", null=ROUNDING, probe=ROUNDING, low=0.02, high=5.0),
    )
    further_probes = ({"threshold": 3e4, "rounding": 0.5},)

    def inputs(self, pressure: ca.SX, tension: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> tuple[ca.SX, ca.SX]:
        corner = parameters["threshold"], parameters["rounding"]
        return subtract_threshold(pressure, *corner) - subtract_threshold(ca.SX(0), *corner), tension

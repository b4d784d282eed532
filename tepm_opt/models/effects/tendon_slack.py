"""Tendons that hang loose at first."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter
from tepm_opt.models.effects.corners import above


class TendonSlack(Effect):
    """Tension in the tendon max(λ - tension, 0): what is commanded up to that tension only takes up slack. The corner is rounded."""

    name = "tendon_slack"
    explains = "a tendon carries no load until its slack is taken up"
    reference = "Tao and Kokotović, Adaptive Control of Systems with Actuator and Sensor Nonlinearities, 1996, ch. 2"
    smooth = False  # at no slack and no tension the derivative by the slack has a jump
    parameters = (Parameter("tension", "N", null=0.0, probe=0.1, low=0.0, high=100.0),)

    def inputs(self, pressure: ca.SX, tension: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> tuple[ca.SX, ca.SX]:
        return pressure, above(tension, parameters["tension"])

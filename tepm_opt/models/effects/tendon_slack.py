"""Tendons that hang loose at first."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter
from tepm_opt.models.effects.corners import above


class TendonSlack(Effect):
    """Tension in the tendon max(λ - tension, 0): what is commanded up to that tension only takes up slack. The corner is rounded.

    A muscle that pressure lengthens takes up slack, too: `take_up` less is left of that tension with every pascal.
    """

    name = "tendon_slack"
    explains = "a tendon carries no load until its slack is taken up"
    reference = "Tao and Kokotović, Adaptive Control of Systems with Actuator and Sensor Nonlinearities, 1996, ch. 2"
    smooth = False  # at no slack and no tension the derivative by the slack has a jump
    parameters = (
        Parameter("tension", "N", null=0.0, probe=0.1, low=0.0, high=100.0),
        Parameter("take_up", "N/Pa", null=0.0, probe=0.0, low=0.0, high=1e-2, change=1e-6),
    )
    further_probes = ({"tension": 0.1, "take_up": 1e-6}, {"tension": 0.1, "take_up": 4e-6})

    def inputs(self, pressure: ca.SX, tension: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> tuple[ca.SX, ca.SX]:
        left = ca.fmax(parameters["tension"] - parameters["take_up"] * ca.fmax(pressure, 0), 0)
        return pressure, above(tension, left)

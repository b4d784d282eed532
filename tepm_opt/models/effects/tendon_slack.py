"""Tendons that hang loose at first."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter
from tepm_opt.models.effects.corners import ROUNDING, SMALLEST_WIDTH, mean_ramp


class TendonSlack(Effect):
    """Slack of tendons, which commands up to a tension only take up: max(λ - max(tension - take_up · stretch, 0), 0) is in the tendon.

    A muscle that lengthens takes up slack, too: `take_up` is the elasticity of motor and dynamometer (N/m) times the muscle's length,
    the stretch that of each edge over its rest length. Corners are rounded.
    """

    name = "tendon_slack"
    explains = "a tendon carries no load until its slack is taken up"
    reference = "Tao and Kokotović, Adaptive Control of Systems with Actuator and Sensor Nonlinearities, 1996, ch. 2"
    smooth = False  # at no slack and no tension the derivative by the slack has a jump
    parameters = (
        Parameter("tension", "N", null=0.0, probe=0.1, low=0.0, high=100.0),
        Parameter("take_up", "N", null=0.0, probe=0.0, low=0.0, high=1e4, change=1.0),
    )
    further_probes = ({"tension": 0.1, "take_up": 2.0}, {"tension": 0.4, "take_up": 8.0})

    def tendon_energy(self, length: ca.SX, rest: ca.SX, tension: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        slack = parameters["tension"]
        width = ca.fmax(ROUNDING * slack, SMALLEST_WIDTH)
        taken_up = parameters["take_up"] * (length - rest) / rest
        carried = mean_ramp(tension - slack, taken_up, width) - mean_ramp(-slack, taken_up, width)
        return (length - rest) * (carried - tension)

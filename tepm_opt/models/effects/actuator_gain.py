"""One muscle that is not like the others."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter


class ActuatorGain(Effect):
    """One muscle's pressure gives less force by a share, or more where that is negative; its tendon is left alone."""

    name = "actuator_gain"
    explains = "one actuator is weaker or stronger than the others"
    reference = "multiplicative actuator fault; Isermann, Fault-Diagnosis Systems, 2006"
    detail = "actuator"
    parameters = (Parameter("loss", "1", null=0.0, probe=0.02, low=-1.0, high=1.0),)

    def inputs(self, pressure: ca.SX, tension: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> tuple[ca.SX, ca.SX]:
        at = divmod(context.detail or 0, context.layout.actuators)
        weaker = ca.SX(pressure)
        weaker[at] = (1 - parameters["loss"]) * pressure[at]
        return weaker, tension

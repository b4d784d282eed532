"""One tendon that is pulled otherwise than its dynamometer says."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter


class TensionGain(Effect):
    """One tendon's tension is less by a share, or more where that is negative: its dynamometer's scale is off.

    The share grows by `bend` with every newton where the scale is not straight.

    A dynamometer's zero is a constant force of the muscle beside it: `actuator_offset`, which positions cannot tell from it.
    """

    name = "tension_gain"
    explains = "one tendon is pulled less or more than its dynamometer says"
    reference = "multiplicative sensor fault in a loop; Isermann, Fault-Diagnosis Systems, 2006"
    detail = "actuator"
    parameters = (
        Parameter("loss", "1", null=0.0, probe=0.02, low=-1.0, high=1.0),
        Parameter("bend", "1/N", null=0.0, probe=0.0, low=-1.0, high=1.0, change=0.05),
    )

    def inputs(self, pressure: ca.SX, tension: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> tuple[ca.SX, ca.SX]:
        at = divmod(context.detail or 0, context.layout.actuators)
        weaker = ca.SX(tension)
        weaker[at] = (1 - parameters["loss"] * (1 + parameters["bend"] * tension[at])) * tension[at]
        return pressure, weaker

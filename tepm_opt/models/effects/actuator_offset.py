"""One muscle that pushes more or less than the others whatever it is told."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter, Properties
from tepm_opt.models.effects.corners import no_less_than_nothing


class ActuatorOffset(Effect):
    """A constant axial force of one muscle, given as the pressure that would make it; there at no pressure, too, and of either sign.

    A muscle whose rest length is off by d pushes by K_a d more, a regulator whose zero is off by p by A p. Positions cannot tell the
    two: for `kang2017` 1 kPa is 0.050 N or 0.14 mm, and 1 mm is 0.359 N or 7.1 kPa. A tendon's dynamometer with a wrong zero is a
    third form, with the sign turned round: 1 N of tension is -19.9 kPa. Where a regulator gives too little it still gives no less than
    nothing: `one_sided` 1, which tells it from a rest length (0). Only that limit is a map of what is commanded; the constant is beside
    it, where no threshold or slack cuts it off, and where tendons may hold less than it pushes.
    """

    name = "actuator_offset"
    explains = "one muscle's rest length or its regulator's zero is off"
    exact = True
    reference = "additive actuator fault; Isermann, Fault-Diagnosis Systems, 2006"
    detail = "actuator"
    corners = True
    parameters = (
        Parameter("pressure", "Pa", null=0.0, probe=-2e3, low=-1e6, high=1e6),
        Parameter("one_sided", "1", null=0.0, probe=0.0, low=0.0, high=1.0, change=0.2),
    )

    def inputs(self, pressure: ca.SX, tension: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> tuple[ca.SX, ca.SX]:
        at = divmod(context.detail or 0, context.layout.actuators)
        given = ca.SX(pressure)
        given[at] = no_less_than_nothing(pressure[at], parameters["pressure"], parameters["one_sided"])
        return given, tension

    def properties(self, properties: Properties, parameters: Mapping[str, ca.SX], context: Context) -> None:
        at = divmod(context.detail or 0, context.layout.actuators)
        properties.pressure[at] += parameters["pressure"]

"""A sensor that sits beside its reference point."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter


class SensorOffset(Effect):
    """One reference point is measured a constant vector away, in the tracker frame G: it does not turn with the robot."""

    name = "sensor_offset"
    explains = "one reference point's holder arm is not compensated"
    reference = "constant displacement; SPEC section 5"
    detail = "point"
    parameters = tuple(Parameter(axis, "m", null=0.0, probe=1e-3, low=-0.1, high=0.1) for axis in "xyz")

    def outputs(self, points: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        measured = ca.SX(points)
        measured[:, context.detail or 0] += ca.vertcat(*(parameters[axis] for axis in "xyz"))
        return measured

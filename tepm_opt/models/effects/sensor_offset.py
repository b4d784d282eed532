"""A sensor that sits beside its reference point."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from tepm_opt.models.effect import Context, Effect, Parameter

TINY = 1e-12  # m², keeps quotients finite where a point sits on the base


class SensorOffset(Effect):
    """One reference point is measured a vector away, in the tracker frame G; `turns` says how much of it turns with the robot there.

    An arm turns as the backbone does, without twist, an arc from point to point (piecewise constant curvature).
    """

    name = "sensor_offset"
    explains = "one reference point's holder arm is not compensated"
    exact = True
    reference = "holder arm that turns with its plate; arcs: Webster and Jones, IJRR 29 (2010)"
    detail = "point"
    parameters = (
        *(Parameter(axis, "m", null=0.0, probe=1e-3, low=-0.1, high=0.1) for axis in "xyz"),
        Parameter("turns", "1", null=0.0, probe=0.0, low=0.0, high=1.0, change=0.5),
    )

    def outputs(self, points: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        at = context.detail or 0
        arm = ca.vertcat(*(parameters[axis] for axis in "xyz"))
        turned = _turned_along(ca.horzcat(ca.DM(context.position), points[:, : at + 1]), context.rotation[:, 2], arm)
        measured = ca.SX(points)
        measured[:, at] += arm + parameters["turns"] * (turned - arm)
        return measured


def _turned_along(points: ca.SX, tangent: np.ndarray, arm: ca.SX) -> ca.SX:
    """A vector at the first point, (3,), as it is at the last, carried along arcs through the points, (3, points), without twist."""
    before = ca.SX(ca.DM(tangent))
    for k in range(points.shape[1] - 1):
        chord = points[:, k + 1] - points[:, k]
        after = 2 * ca.dot(chord, before) / ca.fmax(ca.sumsqr(chord), TINY) * chord - before
        axis = ca.cross(before, after)  # arm + axis × arm + axis × (axis × arm) / (1 + cos): Rodrigues' formula
        arm = arm + ca.cross(axis, arm) + ca.cross(axis, ca.cross(axis, arm)) / (1 + ca.dot(before, after))
        before = after
    return arm

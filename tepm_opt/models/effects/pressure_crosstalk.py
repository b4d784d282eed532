"""Muscles that feel their neighbours' pressure."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter
from tepm_opt.models.layout import DIAGONAL

USUAL = 1e5  # Pa


class PressureCrosstalk(Effect):
    """A share of a muscle's pressure adds to that of the muscles on either side of it in the module.

    The share is that at 100 kPa and grows by `bend` of itself with every pascal where the muscle that presses bulges.
    """

    name = "pressure_crosstalk"
    explains = "pressure in one muscle acts on its neighbours in the module"
    reference = "linear interaction; Skogestad and Postlethwaite, Multivariable Feedback Control, 2nd ed., 2005, ch. 3"
    parameters = (
        Parameter("coupling", "1", null=0.0, probe=0.01, low=-0.4, high=0.4),
        Parameter("bend", "1/Pa", null=0.0, probe=0.0, low=-1e-5, high=1e-5, change=5e-7),
    )

    def inputs(self, pressure: ca.SX, tension: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> tuple[ca.SX, ca.SX]:
        neighbours = ca.DM(context.layout.actuators, context.layout.actuators)
        for edge in context.layout.edges:
            if edge.kind == DIAGONAL:  # joins two muscles that share a face
                i, j = edge.a[1], edge.b[1]
                neighbours[i, j] = neighbours[j, i] = 1
        pressing = pressure * (1 + parameters["bend"] * (pressure - USUAL))
        return pressure + parameters["coupling"] * (pressing @ neighbours), tension

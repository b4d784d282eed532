"""Muscles that stiffen with stretch."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter
from tepm_opt.models.layout import VERTICAL, Edge


class StiffnessHardening(Effect):
    """A muscle stretched by s (elongation over rest length) pulls with quadratic s² + cubic s³ more than its K_a L_0 s.

    The parameters are forces at double length, so they do not depend on how many segments a muscle has; relative growth
    of stiffness is had by dividing them by K_a L_0 (72 N for kang2017).
    """

    name = "stiffness_hardening"
    explains = "actuator stiffness grows with stretch"
    reference = "quadratic and cubic spring; Kovacic and Brennan (eds.), The Duffing Equation, 2011, ch. 2"
    parameters = (
        Parameter("quadratic", "N", null=0.0, probe=20.0, low=0.0, high=1e4),
        Parameter("cubic", "N", null=0.0, probe=50.0, low=0.0, high=1e5),
        Parameter("compressed", "1", null=1.0, probe=1.0, low=0.0, high=1.0, finer=True),
    )

    def edge_energy(self, edge: Edge, length: ca.SX, rest: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        if edge.kind != VERTICAL:
            return ca.SX(0)
        stretch = length / rest - 1
        part = ca.if_else(stretch < 0, parameters["compressed"], 1)
        return part * rest * (parameters["quadratic"] * stretch**3 / 3 + parameters["cubic"] * stretch**4 / 4)

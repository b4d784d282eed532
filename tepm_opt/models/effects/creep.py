"""Muscles whose force relaxes after a stretch."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter
from tepm_opt.models.layout import VERTICAL, Edge
from tepm_opt.models.memories import Memory

FASTEST = 0.05  # s


class Creep(Effect):
    """Maxwell element (a spring and a damper in series) beside every muscle segment: the standard linear solid.

    Its equilibrium is that of the muscle without it: creep is over at rest. What relaxes within `FASTEST` is damping.
    """

    name = "creep"
    explains = "viscoelastic relaxation of the muscles"
    reference = "standard linear solid (Zener); Lakes, Viscoelastic Materials, 2009, section 2.6"
    parameters = (
        Parameter("share", "1", null=0.0, probe=0.1, low=0.0, high=10.0),
        Parameter("relaxation_time", "s", null=1.0, probe=1.0, low=FASTEST, high=1e4),
    )
    further_probes = ({"relaxation_time": 0.2}, {"relaxation_time": 5.0})

    def edge_memory(
        self, edge: Edge, length: ca.SX, rate: ca.SX, properties: Mapping[str, ca.SX], parameters: Mapping[str, ca.SX], context: Context
    ) -> Memory | None:
        if edge.kind != VERTICAL:
            return None
        return Memory(parameters["share"] * properties["stiffness"] * rate, ca.SX(1), parameters["relaxation_time"])

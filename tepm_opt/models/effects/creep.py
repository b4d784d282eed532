"""Muscles whose force relaxes after a stretch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter
from tepm_opt.models.layout import VERTICAL, Edge
from tepm_opt.models.memories import Memory

FASTEST = 0.05  # s
SLOWER = 10.0  # times the relaxation time: how slowly the slow part relaxes


class Creep(Effect):
    """Two Maxwell elements (a spring and a damper in series each) beside every muscle segment: a Prony series over a decade.

    With no slow part it is the standard linear solid; rubber relaxes over decades of time. The equilibrium is that of the muscle without
    it: creep is over at rest. What relaxes within `FASTEST` is damping.
    """

    name = "creep"
    explains = "viscoelastic relaxation of the muscles"
    reference = "standard linear solid and Prony series; Lakes, Viscoelastic Materials, 2009, sections 2.6 and 2.8"
    parameters = (
        Parameter("share", "1", null=0.0, probe=0.1, low=0.0, high=10.0),
        Parameter("relaxation_time", "s", null=1.0, probe=1.0, low=FASTEST, high=1e4),
        Parameter("slow_part", "1", null=0.0, probe=0.0, low=0.0, high=1.0, change=0.2),
    )
    further_probes = ({"relaxation_time": 0.2}, {"relaxation_time": 5.0})

    def edge_memory(
        self, edge: Edge, length: ca.SX, rate: ca.SX, properties: Mapping[str, ca.SX], parameters: Mapping[str, ca.SX], context: Context
    ) -> Sequence[Memory]:
        if edge.kind != VERTICAL:
            return ()
        drive, slow = parameters["share"] * properties["stiffness"] * rate, parameters["slow_part"]
        parts = ((1 - slow, parameters["relaxation_time"]), (slow, SLOWER * parameters["relaxation_time"]))
        return tuple(Memory(part * drive, ca.SX(1), time) for part, time in parts)

"""Dry friction inside the body: muscle on muscle, plates, holders."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter
from tepm_opt.models.layout import VERTICAL, Edge
from tepm_opt.models.memories import Memory


class StructuralFriction(Effect):
    """Dahl's bristles along every muscle segment: elastic until a stick distance, then a force against the motion.

    The force is a constant and a share of what the muscle's spring pulls with, which presses sheath, plates and holders together
    (Coulomb). At rest in statics the force is 0, the middle of its stick band.
    """

    name = "structural_friction"
    explains = "dry friction inside the body"
    reference = "Dahl, A solid friction model, Aerospace Corp. TOR-0158(3107-18)-1, 1968"
    parameters = (
        Parameter("force", "N", null=0.0, probe=0.1, low=0.0, high=100.0),
        Parameter("distance", "m", null=1e-3, probe=1e-3, low=1e-5, high=0.1),
        Parameter("share", "1", null=0.0, probe=0.0, low=0.0, high=0.9, change=0.02),
    )
    further_probes = (  # little of it may have much to say, where much of it sticks
        {"force": 0.02},
        {"force": 0.02, "distance": 1e-4},
        {"force": 0.0, "share": 0.02, "distance": 2e-4},
        {"force": 0.0, "share": 0.05, "distance": 3e-4},
    )

    def edge_memory(
        self, edge: Edge, length: ca.SX, rate: ca.SX, properties: Mapping[str, ca.SX], parameters: Mapping[str, ca.SX], context: Context
    ) -> Memory | None:
        if edge.kind != VERTICAL:
            return None
        distance = parameters["distance"] / context.layout.segments  # an actuator's, shared by its segments
        force = parameters["force"] + parameters["share"] * ca.fabs(properties["stiffness"] * (length - properties["rest"]))
        return Memory(force / distance * rate, ca.fabs(rate), distance)

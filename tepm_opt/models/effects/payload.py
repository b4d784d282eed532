"""A mass at the tip that the model does not know."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from tepm_opt.models.effect import Context, Effect, Parameter, Properties
from tepm_opt.models.layout import VERTICAL, Edge


class Payload(Effect):
    """Mass shared by the nodes of the tip level: weight and inertia (gravity is applied after it).

    Where it sits `beside_x`, `beside_y` from the tip's centre, in parts of the actuators' radius, its weight bends the body, too: with the
    moment it has where plates are level, which acts along the actuators all the way down.
    """

    name = "payload"
    explains = "unmodelled mass at the tip"
    reference = "rigid point mass"
    parameters = (
        Parameter("mass", "kg", null=0.0, probe=0.01, low=0.0, high=10.0),
        Parameter("beside_x", "1", null=0.0, probe=0.0, low=-1.0, high=1.0, change=0.1),
        Parameter("beside_y", "1", null=0.0, probe=0.0, low=-1.0, high=1.0, change=0.1),
    )

    def properties(self, properties: Properties, parameters: Mapping[str, ca.SX], context: Context) -> None:
        properties.mass[-1] += parameters["mass"] / context.layout.actuators

    def edge_energy(self, edge: Edge, length: ca.SX, rest: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        if edge.kind != VERTICAL or context.layout.guided:
            return ca.SX(0)
        angles = np.array(context.layout.angles)
        more = np.linalg.pinv(np.stack([np.ones_like(angles), np.cos(angles), np.sin(angles)]))[edge.a[1], 1:]  # of the mass, by node
        share = float(more[0]) * parameters["beside_x"] + float(more[1]) * parameters["beside_y"]
        return -parameters["mass"] * share * float(context.gravity[2]) * (length - rest)

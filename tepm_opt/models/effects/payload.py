"""A mass at the tip that the model does not know."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter, Properties


class Payload(Effect):
    """Mass shared by the nodes of the tip level: weight and inertia (gravity is applied after it)."""

    name = "payload"
    explains = "unmodelled mass at the tip"
    reference = "rigid point mass; SPEC section 5"
    parameters = (Parameter("mass", "kg", null=0.0, probe=0.01, low=0.0, high=10.0),)

    def properties(self, properties: Properties, parameters: Mapping[str, ca.SX], context: Context) -> None:
        properties.mass[-1] += parameters["mass"] / context.layout.actuators

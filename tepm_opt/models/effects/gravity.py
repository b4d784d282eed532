"""Weight of the network: part of every model."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Properties


class Gravity(Effect):
    """m g on every node, with the masses all effects have left."""

    name = "gravity"
    explains = "weight of the robot"
    reference = "SPEC section 2, Π"

    def loads(self, properties: Properties, external: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        return context.layout.actuators * ca.mtimes(ca.DM(context.gravity), properties.mass.T)

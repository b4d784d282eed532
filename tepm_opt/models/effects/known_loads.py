"""Known external forces on the tip and the other reference points: part of every model."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Properties


class KnownLoads(Effect):
    """Forces given with the inputs; a point's force is shared by its levels' nodes. The base takes what falls on level 0."""

    name = "known_loads"
    explains = "known external force on a reference point"
    reference = "SPEC section 2, Π"

    def loads(self, properties: Properties, external: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        in_base = ca.mtimes(ca.DM(context.rotation.T), external)
        return ca.mtimes(in_base, ca.DM(context.layout.point_weights[:, 1:]))

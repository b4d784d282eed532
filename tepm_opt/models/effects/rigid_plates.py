"""Connecting plates and end caps that hold on to the muscles' ends."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter, Properties


class RigidPlates(Effect):
    """All edges of a module's first and last segment are stiffer; their damping stays."""

    name = "rigid_plates"
    explains = "connecting plates and end caps stiffen the segments next to them"
    reference = "Kang et al., Design of a Pneumatic Muscle Based Continuum Robot with Embedded Tendons, IV.B, (2) and Eq. (4)"
    parameters = (Parameter("stiffening", "1", null=0.0, probe=0.2, low=0.0, high=20.0),)

    def properties(self, properties: Properties, parameters: Mapping[str, ca.SX], context: Context) -> None:
        segments = context.layout.segments
        for segment in range(context.layout.levels):
            if segment % segments in (0, segments - 1):
                properties.stiffness[:, segment] *= 1 + parameters["stiffening"]

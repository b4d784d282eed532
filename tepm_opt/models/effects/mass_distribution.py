"""Mass that sits at plates and holders."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter, Properties


class MassDistribution(Effect):
    """Shares of a module's mass that sit at its end (plate) and at half its height (sensor holder); the rest is spread evenly.

    The holder's level is that of the reference point; what falls on level 0 (half of the first holder's for one segment a module)
    the base takes. How much a module weighs is read off level 1, which no payload changes.
    """

    name = "mass_distribution"
    explains = "mass concentrated at plates and holders instead of spread evenly"
    exact = True
    reference = "lumped masses; Kang et al., Design of a Pneumatic Muscle Based Continuum Robot with Embedded Tendons, IV.B, (3)"
    parameters = (
        Parameter("plates", "1", null=0.0, probe=0.1, low=0.0, high=0.45),
        Parameter("holders", "1", null=0.0, probe=0.1, low=0.0, high=0.45),
    )

    def properties(self, properties: Properties, parameters: Mapping[str, ca.SX], context: Context) -> None:
        holder, plate = (ca.DM(context.layout.point_weights[start::2, 1:].sum(axis=0)) for start in (0, 1))
        even, segments = properties.mass[0], context.layout.segments
        for share, weights in ((parameters["holders"], holder), (parameters["plates"], plate)):
            properties.mass += share * even * (segments * weights - 1)

"""An unknown constant force on the tip."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter, Properties


class ExternalLoad(Effect):
    """A force in the tracker frame G that does not move with the robot, shared by the nodes of the tip level."""

    name = "external_load"
    explains = "unknown constant force on the tip (hose drag)"
    exact = True
    reference = "Rucker and Webster, Deflection-based force sensing for continuum robots: A probabilistic approach, IROS 2011"
    parameters = tuple(Parameter(axis, "N", null=0.0, probe=0.02, low=-50.0, high=50.0) for axis in "xyz")

    def loads(self, properties: Properties, external: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        force = ca.mtimes(ca.DM(context.rotation.T), ca.vertcat(*(parameters[axis] for axis in "xyz")))
        return ca.mtimes(force, ca.DM(context.layout.point_weights[-1:, 1:]))

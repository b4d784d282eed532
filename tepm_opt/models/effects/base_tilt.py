"""A base that is not vertical."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter, Properties
from tepm_opt.models.effects.rotations import rotation


class BaseTilt(Effect):
    """Base and tracker frame G together are turned about G's y axis, then x axis: only gravity comes from elsewhere.

    Acts on the masses all effects have left; known forces are given in the turned G.
    """

    name = "base_tilt"
    explains = "the base is not vertical: gravity acts obliquely"
    exact = True
    reference = "Murray, Li and Sastry, A Mathematical Introduction to Robotic Manipulation, 1994, ch. 2"
    parameters = tuple(Parameter(axis, "rad", null=0.0, probe=0.01, low=-0.5, high=0.5) for axis in "xy")

    def loads(self, properties: Properties, external: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        assumed = ca.DM(context.rotation @ context.gravity)
        turned = rotation(parameters["x"], parameters["y"], ca.SX(0)).T @ assumed
        change = ca.mtimes(ca.DM(context.rotation.T), turned - assumed)
        return context.layout.actuators * ca.mtimes(change, properties.mass.T)

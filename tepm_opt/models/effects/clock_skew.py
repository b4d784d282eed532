"""Clocks of inputs and positions that run apart."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import BEGAN, CLOCK, Context, Effect, Parameter, Properties


class ClockSkew(Effect):
    """The positions' clock gains a share of the time since the run began on that of the inputs, which is right.

    Both start with the recording of a run, as frames that are counted at the tracker's nominal rate do; what is late from the start is a
    delay. By the positions' clock inputs act later and later and the robot is slower: masses are as if larger by the square of what the
    clock gains, dampers in proportion, while weights stay. Nothing shows at rest.
    """

    name = "clock_skew"
    explains = "the clocks of inputs and positions run apart"
    reference = "affine clock model; Allan, Time and frequency characterization of precision clocks, IEEE Trans. UFFC 34 (1987)"
    timed = True
    delays_forces = True
    parameters = (Parameter("rate", "1", null=0.0, probe=1e-3, low=-0.05, high=0.05),)

    def delay(self, parameters: Mapping[str, ca.SX]) -> ca.SX:
        return parameters["rate"] * (parameters[CLOCK] - parameters[BEGAN])

    def properties(self, properties: Properties, parameters: Mapping[str, ca.SX], context: Context) -> None:
        pace = 1 - parameters["rate"]
        properties.mass /= pace**2
        properties.damping /= pace

    def loads(self, properties: Properties, external: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        more = (1 - (1 - parameters["rate"]) ** 2) * properties.mass  # that weighs nothing
        return -context.layout.actuators * ca.mtimes(ca.DM(context.gravity), more.T)

"""Muscles whose stiffness changes while they warm up."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from tepm_opt.models.effect import CLOCK, Context, Effect, Parameter, Properties

AT_ONCE = 1e-9  # s, so that the slope of a power of no time is a number


class WarmUp(Effect):
    """The muscles' stiffness changes by a share as they warm up over the session, from none at its start.

    Lumped heat capacity: temperature, and with it the rubber's stiffness, nears its end with one time constant: exponentially for a
    `bend` of 1. A larger one begins later and ends sooner, as heat that has to soak through does. At rest the clock stands still, by
    default at the session's start: the muscles are as cold as K_a says.
    """

    name = "warm_up"
    explains = "the muscles' stiffness changes as they warm up over the session"
    reference = "lumped capacitance; Incropera and DeWitt, Fundamentals of Heat and Mass Transfer, 6th ed., 2007, section 5.1"
    timed = True
    parameters = (
        Parameter("change", "1", null=0.0, probe=-0.05, low=-0.9, high=10.0),
        Parameter("time_constant", "s", null=100.0, probe=100.0, low=10.0, high=1e5),
        Parameter("bend", "1", null=1.0, probe=1.0, low=0.5, high=4.0, finer=True),
    )

    def properties(self, properties: Properties, parameters: Mapping[str, ca.SX], context: Context) -> None:
        warmth = -ca.expm1(-(((parameters[CLOCK] + AT_ONCE) / parameters["time_constant"]) ** parameters["bend"]))
        properties.stiffness[: context.layout.actuators, :] *= 1 + parameters["change"] * warmth

    def suggest_values(self, clock: np.ndarray, began: np.ndarray, left: np.ndarray) -> Mapping[str, float]:
        """A third of the session, in which most of the change happens."""
        return {"time_constant": float(np.clip(clock[-1] / 3, 10.0, 1e5))}

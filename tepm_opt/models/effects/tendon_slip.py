"""A tendon that slips."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from tepm_opt.models.effect import CLOCK, Context, Effect, Parameter

DURATION = 0.02  # s, of the slip (10 to 90 % in 4.4 times this): no longer than a time step, so that steps do not step over it
SHORTEST = 1.0  # s before and after the instant, that tell it
LEAST = 1e-3  # of the noise's variance: what does not move at all tells nothing


class TendonSlip(Effect):
    """One tendon loses a share of its tension at an instant of the session and does not get it back, in later runs neither.

    What a clamp or a knot gives way by nobody takes up again before the session is over. The loss follows a logistic curve, so that
    outputs are differentiable in the instant. At rest the clock stands still, by default at the session's start.
    """

    name = "tendon_slip"
    explains = "one tendon loses part of its tension at an instant"
    reference = "abrupt multiplicative actuator fault; Isermann, Fault-Diagnosis Systems, 2006, ch. 2"
    detail = "actuator"
    timed = True
    happens = "instant"
    parameters = (
        Parameter("share", "1", null=0.0, probe=0.1, low=-1.0, high=1.0),
        Parameter("instant", "s", null=10.0, probe=10.0, low=0.0, high=1e7, change=0.1),
    )

    def inputs(self, pressure: ca.SX, tension: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> tuple[ca.SX, ca.SX]:
        at = divmod(context.detail or 0, context.layout.actuators)
        over = (1 + ca.tanh((parameters[CLOCK] - parameters["instant"]) / (2 * DURATION))) / 2
        slipped = ca.SX(tension)
        slipped[at] = (1 - parameters["share"] * over) * tension[at]
        return pressure, slipped

    def suggest_values(self, clock: np.ndarray, began: np.ndarray, left: np.ndarray) -> Mapping[str, float]:
        """The instant before and after which coordinates scatter most differently: the likeliest change of their means and variances.

        Killick, Fearnhead and Eckley, Optimal detection of changepoints with a linear computational cost, JASA 107 (2012).
        """
        count = np.arange(1, len(clock))[:, None]
        sums, squares = np.cumsum(left, axis=0), np.cumsum(left**2, axis=0)
        cost = np.zeros(len(count))
        for n, total, square in ((count, sums[:-1], squares[:-1]), (len(clock) - count, sums[-1] - sums[:-1], squares[-1] - squares[:-1])):
            cost += (n * np.log(np.maximum(square / n - (total / n) ** 2, LEAST))).sum(axis=1)
        inside = (clock[1:] - clock[0] > SHORTEST) & (clock[-1] - clock[1:] > SHORTEST)
        return {"instant": float(clock[1:][inside][np.argmin(cost[inside])])} if inside.any() else {}

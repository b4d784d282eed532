"""Friction between the motor and the tendon's end."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from tepm_opt.models.effect import Context, Effect, Parameter
from tepm_opt.models.layout import VERTICAL, Edge
from tepm_opt.models.memories import Memory, Play

SMALLEST_DISTANCE = 1e-6  # N; keeps quotients finite where a tendon is loose


class TendonFriction(Effect):
    """The tendon's tension trails the commanded one by a constant (gasket) and a share of it (guides) against its last change.

    A play with rounded corners: after a reversal the tendon's end sticks until friction has turned over, then it follows;
    `distance` is the commanded tension over which sticking turns into following. What friction holds when the motor lets go
    stays in the tendon, but for the part `released` of the constant one; it never pushes.

    That is friction where the motor pulls the tendon through. The part `by_motion` of the guides' turns over where the muscle draws the
    tendon out or lets it in instead, whatever the motor does: bristles along every segment, elastic over a `travel` of the whole
    actuator. (A constant force that does so is dry friction of the body.)
    """

    name = "tendon_friction"
    explains = "friction between motor and tendon end, dependent on direction"
    reference = "Brokate and Sprekels, Hysteresis and Phase Transitions, 1996, ch. 2 (play); the share is the capstan equation's"
    parameters = (
        Parameter("constant", "N", null=0.0, probe=0.1, low=0.0, high=10.0),
        Parameter("share", "1", null=0.0, probe=0.05, low=0.0, high=0.9),
        Parameter("released", "1", null=0.0, probe=0.0, low=0.0, high=1.0, change=0.6),
        Parameter("distance", "N", null=0.05, probe=0.05, low=1e-3, high=10.0),
        Parameter("by_motion", "1", null=0.0, probe=0.0, low=0.0, high=1.0, change=0.5),
        Parameter("travel", "m", null=5e-4, probe=5e-4, low=1e-5, high=0.1, finer=True),
    )
    feels_tension = True
    further_probes = ({"by_motion": 1.0}, {"constant": 0.0, "share": 0.2, "by_motion": 1.0})

    def friction(self, parameters: Mapping[str, ca.SX]) -> tuple[ca.SX, ca.SX]:
        return parameters["constant"], parameters["share"]

    def friction_travel(self, values: Mapping[str, float]) -> str | None:
        return "travel" if values["by_motion"] > 0.5 else None

    def tension_memory(self, tension: ca.SX, rate: ca.SX, state: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> Play:
        friction = parameters["constant"] + (1 - parameters["by_motion"]) * parameters["share"] * tension
        let_go = parameters["released"] * ca.fmax(parameters["constant"] - tension, 0)
        limit = ca.if_else(rate > 0, -ca.fmin(friction, tension), friction - let_go)
        held = ca.fmax(tension + state, 0)  # in the tendon's end; with none left it follows at once
        return Play(limit, rate > 0, ca.fabs(rate), ca.fmin(parameters["distance"], held) + SMALLEST_DISTANCE, ca.SX(1))

    def edge_memory(
        self, edge: Edge, length: ca.SX, rate: ca.SX, properties: Mapping[str, ca.SX], parameters: Mapping[str, ca.SX], context: Context
    ) -> Memory | None:
        if edge.kind != VERTICAL:
            return None
        friction = parameters["by_motion"] * parameters["share"] * properties["tension"]
        travel = parameters["travel"] / context.layout.segments
        return Memory(friction / travel * rate, ca.fabs(rate), travel)

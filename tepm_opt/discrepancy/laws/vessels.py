"""Effects on vessels of liquid: they run over, they leak."""

from __future__ import annotations

import casadi as ca

from tepm_opt.discrepancy.laws.effect import At, Law, Quantity


def _lose_above_edge(at: At) -> tuple[ca.SX, list[ca.SX]]:
    """Loss in proportion to the height above the edge, no faster than the time steps resolve; a part of it enters the next vessel."""
    fast = ca.fmin(at.p["flow"], 2 / at.step)
    lost = fast * ca.fmax(at.position - at.p["edge"], 0.0)
    return ca.vertcat(lost, at.p.get("part", 0.0) * lost), []


def _overflow(place: str, explains: str, *more: Quantity) -> Law:
    edges = tuple(1.4**k for k in range(-6, 7))  # so close that one lies just below whatever level the model reaches
    flow, edge = Quantity("flow", "1/time", 0.0, (3.0,), 0.0, 1e3), Quantity("edge", "position", 1.0, edges, 0.01, 1e3, shape=True)
    return Law("overflow", "body", (flow, edge, *more), _lose_above_edge, smooth=False, place=place, explains=explains)


VESSEL = (
    _overflow(
        "vessel", "what is above the edge runs over, a part of it into the next vessel",
        Quantity("part", "1", 0.5, (0.0, 0.5, 1.0), 0.0, 1.0, shape=True),
    ),
    _overflow("last vessel", "what is above the edge runs over"),
    Law(
        "seepage", "body", (Quantity("flow", "1/time", 0.0, (0.01, 0.1), 0.0, 1.0),),
        lambda at: (ca.vertcat(at.p["flow"] * at.position, 0.0), []), place="any vessel",
        explains="the vessel loses liquid through its wall, in proportion to its level", reference="Darcy 1856",
    ),
)  # fmt: skip
"""Effects on the level of a vessel: its loss and the part of that which enters the next vessel, per s."""

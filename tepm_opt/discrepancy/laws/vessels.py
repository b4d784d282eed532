"""What happens to vessels of liquid: they run over, they leak."""

from __future__ import annotations

import casadi as ca

from tepm_opt.discrepancy.laws.effect import At, Law, Quantity

EDGES = tuple(1.4**k for k in range(-6, 7))  # of the usual level: so close that one lies just below whatever level the model reaches


FLOW = Quantity("flow", "1/time", 0.0, (3.0,), 0.0, 1e3)
EDGE = Quantity("edge", "position", 1.0, EDGES, 0.01, 1e3, shape=True)


def _over(at: At) -> tuple[ca.SX, list[ca.SX]]:
    """What is above the edge runs over, in proportion to how high it stands there; a part of it into the next vessel."""
    fast = ca.fmin(at.p["flow"], 2 / at.step)  # what is faster is not resolved
    lost = fast * ca.fmax(at.position - at.p["edge"], 0.0)
    return ca.vertcat(lost, at.p.get("part", 0.0) * lost), []


VESSEL = (
    Law(
        "overflow", "body", (FLOW, EDGE, Quantity("part", "1", 0.5, (0.0, 0.5, 1.0), 0.0, 1.0, shape=True)), _over, smooth=False,
        place="vessel", explains="what is above the edge runs over, a part of it into the next vessel",
    ),
    Law(
        "overflow", "body", (FLOW, EDGE), _over, smooth=False, place="last vessel",
        explains="what is above the edge runs over",
    ),
    Law(
        "seepage", "body", (Quantity("flow", "1/time", 0.0, (0.01, 0.1), 0.0, 1.0),),
        lambda at: (ca.vertcat(at.p["flow"] * at.position, 0.0), []), place="any vessel",
        explains="the vessel loses liquid through its wall, in proportion to its level", reference="Darcy 1856",
    ),
)  # fmt: skip
"""Effects on the level of a vessel: what is lost and what of it runs into the next vessel, per s."""

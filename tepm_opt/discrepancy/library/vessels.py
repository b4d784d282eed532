"""What happens to vessels of liquid: they run over, they leak."""

from __future__ import annotations

import casadi as ca

from tepm_opt.discrepancy.library.effect import At, Law, Quantity

EDGES = tuple(1.25**k for k in range(-6, 5))  # of the usual level: close enough that some lie below whatever level a model reaches


def _over(at: At) -> tuple[ca.SX, list[ca.SX]]:
    """All above the edge runs over so fast, a part of it into the next vessel."""
    fast = ca.fmin(at.p["flow"], 2 / at.step)
    lost = fast * ca.fmax(at.position - at.p["edge"], 0.0)
    return ca.vertcat(lost, at.p["part"] * lost), []


VESSEL = (
    Law(
        "overflow", "body",
        (
            Quantity("flow", "1/time", 0.0, (1.0, 10.0), 0.0, 1e3),
            Quantity("edge", "position", 1.0, EDGES, 0.01, 1e3, shape=True),
            Quantity("part", "1", 0.5, (0.0, 0.5, 1.0), 0.0, 1.0, shape=True),
        ),
        _over, smooth=False, place="vessel",
        explains="what is above the edge runs over, a part of it into the next vessel",
    ),
    Law(
        "seepage", "body", (Quantity("flow", "1/time", 0.0, (0.01, 0.1), 0.0, 1.0),),
        lambda at: (ca.vertcat(at.p["flow"] * at.position, 0.0), []), place="vessel",
        explains="the vessel loses liquid through its wall, in proportion to its level", reference="Darcy 1856",
    ),
)  # fmt: skip
"""Effects on the level of a vessel: what is lost and what of it runs into the next vessel, per s."""

"""Deviations of a long body from its drawing, along its length: in arrays."""

from __future__ import annotations

from typing import Any

from tepm_opt.discrepancy.laws.effect import At, Law, Quantity


def _scale_by_part(at: At) -> tuple[Any, list[Any]]:
    return at.signal * (1 + at.p["part"]), []


BODIES = (
    Law(
        "radius", "body", (Quantity("part", "1", 0.0, (0.01, 0.1), -0.5, 0.5),), _scale_by_part,
        place="body", explains="the body, or the circle on which its tendons or muscles run, is thicker or thinner",
    ),
    Law(
        "taper", "body", (Quantity("part", "1", 0.0, (0.05, 0.3), -0.9, 0.9),),
        lambda at: (at.signal * (1 - at.p["part"] * at.along), []),
        place="body", explains="what should be alike along the body, or taper as it does, narrows by another part of itself to its tip",
    ),
    Law(
        "stiffness_along", "body", (Quantity("part", "1", 0.0, (0.05, 0.3), -1.5, 1.5),),
        lambda at: (at.signal * (1 + at.p["part"] * (at.along - 0.5)), []),
        place="body", explains="the body is stiffer towards its tip, or its base, than its cross-section says",
    ),
    Law(
        "rest_length", "body", (Quantity("part", "1", 0.0, (0.01, 0.05), -0.3, 0.3),), _scale_by_part,
        place="body", explains="one muscle or chamber is longer or shorter at rest than the others",
    ),
    Law(
        "rest_curvature", "body", (Quantity("rate", "signal", 0.0, (0.01, 0.1), -1.0, 1.0),), lambda at: (at.signal + at.p["rate"], []),
        place="body", explains="the body is bent at rest",
        reference="intrinsic curvature of a rod: Antman 2005, Nonlinear Problems of Elasticity",
    ),
)  # fmt: skip
"""Effects on a quantity of a body: a radius, a stiffness, a length, a rate of turn; `At.along` is 0 at its base and 1 at its tip."""

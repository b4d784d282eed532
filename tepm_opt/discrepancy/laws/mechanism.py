"""Linear elements of a mechanism: an added mass, a spring and a damper, each passive within its range."""

from __future__ import annotations

from tepm_opt.discrepancy.laws.effect import Law, Quantity


def _strength(name: str, size: str) -> Quantity:
    """A strength that no passive element has below 0."""
    return Quantity(name, size, 0.0, (0.01, 0.1, 1.0), 0.0, 10.0)


PAYLOAD = Law(
    "payload", "body", (_strength("mass", "mass"),), lambda at: (at.p["mass"], []), place="mass",
    explains="a mass that the model does not have, with the weight and inertia that its equations give it",
)  # fmt: skip
"""A mass in kg; `Equations.mass` gives it a place."""

MECHANISM = (
    PAYLOAD,
    Law(
        "linear_spring", "body", (_strength("stiffness", "force/position"),), lambda at: (-at.p["stiffness"] * at.position, []),
        explains="a spring towards position 0 that the model does not have", reference="Hooke",
    ),
    Law(
        "linear_damper", "body", (_strength("damping", "force/speed"),), lambda at: (-at.p["damping"] * at.speed, []),
        explains="a force against the motion that grows in proportion to speed",
    ),
)  # fmt: skip
"""Effects on masses and axes."""

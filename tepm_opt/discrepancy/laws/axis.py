"""Forces on an axis that moves: friction, springs that are not linear, hysteresis, a force that is always there."""

from __future__ import annotations

import casadi as ca

from tepm_opt.discrepancy.laws.effect import At, Law, Quantity


def _force(name: str = "force", signed: bool = True) -> Quantity:
    return Quantity(name, "force", 0.0, (0.01, 0.1, 1.0), -10.0 if signed else 0.0, 10.0)


def _way(at: At) -> ca.SX:
    """Direction of motion, -1 … 1; below a hundredth of the axis' usual speed dry friction gives way like a viscous one."""
    return ca.tanh(at.speed / (0.01 * at.sizes["speed"]))


def _bouc_wen(at: At) -> tuple[ca.SX, list[ca.SX]]:
    """The force and its rate, limited to what the time steps can follow; at that limit it is dry friction.

    Passive for stiffness >= 0 and closing >= 0, whatever the opening: dS/dt <= z v with the storage S' = z / (stiffness - opening |z|)
    over all z that it reaches, |z| < stiffness / (closing + opening). With closing = 0 it is a spring, which has no loop.
    """
    (z,), v, p = at.z, at.speed, at.p
    forgets = ca.fabs(v) * (ca.fabs(p["closing"]) + ca.fabs(p["opening"]))
    fastest = 2.0  # decay in a time step; a Runge-Kutta method of order 4 is stable up to 2.78
    slower = ca.fmin(1.0, fastest / ca.fmax(at.step * forgets, 1e-9))
    return -z, [slower * (p["stiffness"] * v - p["closing"] * ca.fabs(v) * z - p["opening"] * v * ca.fabs(z))]


AXIS = (
    Law(
        "dry_friction", "body", (_force(signed=False),), lambda at: (-at.p["force"] * _way(at), []),
        explains="a force against the motion that does not grow with speed", reference="Coulomb; smoothed by a hyperbolic tangent",
        family="friction",
    ),
    Law(
        "constant_force", "body", (_force(),), lambda at: (at.p["force"], []),
        explains="a force that is always there: an amplifier's zero, a slope, a weight",
    ),
    Law(
        "stribeck_friction", "body", (_force(signed=False), Quantity("speed", "speed", 0.1, (0.03, 0.1, 0.3), 0.01, 1.0, shape=True)),
        lambda at: (-at.p["force"] * _way(at) * ca.exp(-((at.speed / at.p["speed"]) ** 2)), []),
        smooth=False, explains="friction that is larger near standstill", reference="Stribeck 1902", beside=("dry_friction",),
    ),
    Law(
        "quadratic_drag", "body", (_force(signed=False),),
        lambda at: (-at.p["force"] * at.speed * ca.fabs(at.speed) / at.sizes["speed"] ** 2, []),
        explains="a force against the motion that grows with the square of speed",
    ),
    Law(
        "quadratic_spring", "body", (_force(),), lambda at: (-at.p["force"] * (at.position / at.sizes["position"]) ** 2, []),
        explains="a spring that is stiffer to one side",
    ),
    Law(
        "cubic_spring", "body", (_force(),), lambda at: (-at.p["force"] * (at.position / at.sizes["position"]) ** 3, []),
        explains="a spring that grows stiffer, or softer, to both sides", reference="Duffing 1918",
    ),
    Law(
        "hysteresis", "body",
        (
            Quantity("stiffness", "force/position", 0.0, (0.1, 1.0), 0.0, 100.0),
            Quantity("closing", "1/position", 1.0, (0.1, 1.0, 10.0), 0.1, 1e3, shape=True),
            Quantity("opening", "1/position", 0.0, (0.0,), -1e3, 1e3, shape=True),
        ),
        _bouc_wen, states=1, smooth=False,
        explains="a force that depends on the way gone before", reference="Bouc 1967, Wen 1976, exponent 1", family="friction",
    ),
)  # fmt: skip
"""Effects on an axis."""

BY_DIRECTION = (
    Law(
        "asymmetric_dry_friction", "body", (_force(),), lambda at: (-at.p["force"] * _way(at) ** 2, []), beside=("dry_friction",),
        explains="dry friction that is larger one way than the other: in motion a constant force, at rest nothing",
    ),
    Law(
        "asymmetric_viscous_friction", "body", (_force(),), lambda at: (-at.p["force"] * ca.fabs(at.speed) / at.sizes["speed"], []),
        explains="viscous friction that is larger one way than the other",
    ),
)  # fmt: skip
"""Friction that differs between directions. No part of `AXIS`: a constant force does nearly the same, ask for it where there is reason."""

"""Effects of soft materials: creep."""

from __future__ import annotations

from tepm_opt.discrepancy.laws.effect import Law, Quantity

SOFT = (
    Law(
        "creep", "body",
        (
            Quantity("stiffness", "force/position", 0.0, (0.1, 1.0), 0.0, 3.0),
            Quantity("time", "time", 1.0, (0.1, 1.0, 10.0), 0.01, 100.0, shape=True),
        ),
        lambda at: (-at.p["stiffness"] * at.z[0], [at.speed - at.z[0] / at.p["time"]]), states=1, smooth=False,
        explains="the body lags: a part of its stiffness gives way with time", reference="Maxwell 1867: a spring on a damper, in parallel",
    ),
)  # fmt: skip
"""Effects on an axis along which a soft body bends or stretches, besides those of any axis."""

"""The numbers that the paper publishes (SPEC section 3), by key."""

from __future__ import annotations

from dataclasses import dataclass

WITHIN = 0.15  # relative deviation that counts as reproduced


@dataclass(frozen=True)
class Published:
    """One number of the paper.

    Attributes:
        figure: of the study to which it belongs, "fig7".
        text: what it is.
        value: as printed, in `unit`.
        unit: as printed.
    """

    figure: str
    text: str
    value: float
    unit: str


def _fig6() -> dict[str, Published]:
    numbers = {
        ("error", 1): (1.85, 3.10, 2.67), ("error", 2): (0.81, 0.93, 0.85),
        ("sd", 1): (2.06, 3.36, 3.51), ("sd", 2): (1.00, 0.87, 0.98),
    }  # fmt: skip
    words = {"error": "mean error", "sd": "standard deviation"}
    return {
        f"fig6_{kind}_mode{mode}_{length}": Published("fig6", f"{words[kind]}, mode {mode}, set point {length} mm", value, "mm")
        for (kind, mode), values in numbers.items()
        for length, value in zip((220, 230, 240), values, strict=True)
    }


PUBLISHED: dict[str, Published] = {
    "free_length": Published("table1", "free actuator, ΔL at 0.5 MPa (III.B)", 70.0, "mm"),
    "K_a": Published("table1", "stiffness of an actuator K_a (III.B)", 358.86, "N/m"),
    "c_v": Published("table1", "damping of a vertical edge c_v (III.B)", 15.50, "N s/m"),
    **_fig6(),
    "fig7_rmse": Published("fig7", "RMSE, Eq. (5)", 5.32, "mm"),
    "fig7_s1": Published("fig7", "error at s1", 1.5, "mm"),
    "fig7_s4": Published("fig7", "error at s4", 7.4, "mm"),
    "fig8_rmse": Published("fig8", "RMSE, Eq. (5)", 8.75, "mm"),
    "fig8_s1": Published("fig8", "error at s1", 2.8, "mm"),
    "fig8_s4": Published("fig8", "error at s4", 11.3, "mm"),
    "fig9_largest": Published("fig9", "largest error of a reference point", 20.1, "mm"),
    "fig9_time": Published("fig9", "when it occurs", 2.0, "s"),
    "fig9_point": Published("fig9", "at which point s_i", 2.0, ""),
    "fig10_rmse": Published("fig10", "RMSE, Eq. (5)", 8.60, "mm"),
    "fig10_angle": Published("fig10", "bending angle under 2.5 N", 65.0, "°"),
    "fig10_hysteresis": Published("fig10", "hysteresis of bending and return", 7.0, "%"),
    "fig11_pressure_sd": Published("fig11", "SD of z_s4, pressure 10–20 %", 5.41, "mm"),
    "fig11_tension_sd": Published("fig11", "SD of z_s4, tension 10–20 %", 1.33, "mm"),
    "fig12_mode1": Published("fig12", "RMSE of tracking, mode 1", 9.77, "mm"),
    "fig12_mode2": Published("fig12", "RMSE of tracking, mode 2", 5.60, "mm"),
}


def is_reproduced(key: str, value: float) -> bool:
    """Whether our value is within 15 % of the published one."""
    published = PUBLISHED[key].value
    return abs(value - published) <= WITHIN * abs(published)

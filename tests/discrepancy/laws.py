"""Thirty causes, fixed beforehand, of which the search for an unknown law has to find the place and the form.

Half are effects of the library in the rig's own forms, which the search is not allowed to use; the others were never in it. Data are
made as in `hidden`; `study_laws` prints what is found. A cause whose imperfection the rig does not have is not made, and counted as missed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tepm_opt.studies.blind.causes import make_setpoint_change
from tepm_opt.studies.blind.excitation import RATE
from tests.discrepancy.hidden import Hidden, curved_lens, sagging_supply, sticking_tendons

AREA = 50.27e-6  # m², of a muscle
Curve = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Trial:
    """A cause and what a right answer says of it.

    Attributes:
        hidden: how its data are made.
        place: "axial", "force", "stiffness", "measurement"; "" where nothing is hidden.
        targets: actuators or points of which one must be named; "all" where all act alike.
        variables: of which one must be named.
        curve: the truth in N (m for a measurement) over its variable, where it is a curve; compared without what recalibration takes.
        terms: names of the terms of which the right formula consists, with their coefficients in SI where they are known.
        removed: effects of the library that are out of bounds.
    """

    hidden: Hidden
    place: str = ""
    targets: tuple[str, ...] = ()
    variables: tuple[str, ...] = ()
    curve: Curve | None = None
    terms: dict[str, float] = field(default_factory=dict)
    removed: tuple[str, ...] = ()


def one(index: int, change: Curve) -> Callable:
    """A change of one column of the commands."""

    @make_setpoint_change
    def changed(time: np.ndarray, pressures: np.ndarray, tensions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        inputs = np.hstack([pressures, tensions])
        inputs[:, index] = change(inputs[:, index])
        return inputs[:, :6], inputs[:, 6:]

    return changed


def pressures(change: Curve) -> Callable:
    """A change of all pressures."""
    return make_setpoint_change(lambda time, pressures, tensions: (change(pressures), tensions))


def lagged(time: float) -> Curve:
    """A first-order lag of some columns, which begin at rest."""

    def change(values: np.ndarray) -> np.ndarray:
        found, keep = values.copy(), np.exp(-1 / (RATE * time))
        for k in range(1, len(values)):
            found[k] = values[k] + keep * (found[k - 1] - values[k])
        return found

    return change


def slewed(rate: float) -> Curve:
    """A limit of the rate of some columns."""

    def change(values: np.ndarray) -> np.ndarray:
        found = values.copy()
        for k in range(1, len(values)):
            found[k] = found[k - 1] + np.clip(values[k] - found[k - 1], -rate / RATE, rate / RATE)
        return found

    return change


def filtered_tip(time: np.ndarray, points: np.ndarray) -> np.ndarray:
    """A tracker that smooths its last point over 0.12 s."""
    found = points.copy()
    found[:, -1] = lagged(0.12)(points[:, -1])
    return found


def _case(key: str, number: int, **how: object) -> Hidden:
    return Hidden(key, seed=600 + number, **how)  # type: ignore[arg-type]


def _library(name: str, number: int, noise: float = 3e-4, **rig: object) -> Hidden:
    return _case(f"law_{name}", number, imperfections={name: rig}, noise=noise)


TRIALS: tuple[Trial, ...] = (
    Trial(
        _library("pressure_dead_zone", 1, threshold_Pa=18e3),
        "axial",
        ("all",),
        ("pressure",),
        lambda p: AREA * (3e3 * np.logaddexp(0.0, (p - 18e3) / 3e3) - 3e3 * np.logaddexp(0.0, -6.0) - p),
        {"ramp": AREA},
        ("pressure_dead_zone",),
    ),
    Trial(
        _case("law_saturation", 2, before=pressures(lambda p: 6e5 * np.tanh(p / 6e5))),
        "axial",
        ("all",),
        ("pressure",),
        lambda p: AREA * (6e5 * np.tanh(p / 6e5) - p),
        {"cubic": -AREA / 3 / 6e5**2},
    ),
    Trial(_case("law_supply", 3, before=sagging_supply, noise=2e-4), "axial", ("all",), ("supply and pressure",)),
    Trial(
        _library("actuator_gain", 4, loss={"21": 0.10}),
        "axial",
        ("21",),
        ("pressure",),
        lambda p: -0.1 * AREA * p,
        {"linear": -0.1 * AREA},
        ("actuator_gain", "actuator_offset", "actuator_scatter", "regulator_leak"),
    ),
    Trial(
        _case("law_bent_muscle", 5, before=one(2, lambda p: p - p**2 / 8e5)),
        "axial",
        ("13",),
        ("pressure",),
        lambda p: -AREA * p**2 / 8e5,
        {"quadratic": -AREA / 8e5},
        ("actuator_gain", "actuator_offset", "actuator_scatter", "regulator_leak"),
    ),
    Trial(
        _case("law_dead_muscle", 6, before=one(1, lambda p: np.maximum(p - 20e3, 0.0))),
        "axial",
        ("12",),
        ("pressure",),
        lambda p: -AREA * np.minimum(p, 20e3),
        {"ramp": AREA},
        ("pressure_dead_zone", "actuator_gain", "actuator_offset", "actuator_scatter", "regulator_leak"),
    ),
    Trial(
        _case("law_shifted_muscle", 7, before=one(4, lambda p: p + 6e3)),
        "axial",
        ("22",),
        ("pressure", "tension", "length", "rate", "time"),
        lambda p: np.full_like(p, AREA * 6e3),
        {"constant": AREA * 6e3},
        ("actuator_offset", "actuator_gain", "actuator_scatter", "regulator_leak"),
    ),
    Trial(
        _library("pressure_hysteresis", 8, width_Pa=10e3),
        "axial",
        ("all",),
        ("pressure remembered",),
        None,
        {"play": 0.0},
        ("pressure_hysteresis",),
    ),
    Trial(
        _library("regulator_lag", 9, fill_s=0.08, exhaust_s=0.08),
        "axial",
        ("all",),
        ("pressure late",),
        None,
        {"lag": 0.08},
        ("regulator_lag", "time_delay"),
    ),
    Trial(_case("law_slow_valve", 10, before=one(5, lagged(0.25))), "axial", ("23",), ("pressure late",), None, {"lag": 0.25}),
    Trial(
        _case("law_slew", 11, before=pressures(slewed(150e3))),
        "axial",
        ("all",),
        ("pressure late", "pressure remembered"),
        None,
        {},
        ("regulator_lag", "time_delay"),
    ),
    Trial(
        _library("pressure_crosstalk", 12, 2e-4, share=0.10),
        "axial",
        ("all",),
        ("neighbours",),
        None,
        {"linear": 0.0},
        ("pressure_crosstalk",),
    ),
    Trial(
        _library("tendon_slack", 13, 2e-4, length_m=0.07, winding_stiffness_N_per_m=8.0),
        "axial",
        ("all",),
        ("tension",),
        None,
        {"ramp": 1.0},
        ("tendon_slack",),
    ),
    Trial(
        _case("law_sticking_tendons", 14, before=sticking_tendons),
        "axial",
        ("all",),
        ("tension remembered",),
        None,
        {"play": 0.0},
        ("tendon_friction",),
    ),
    Trial(
        _case("law_weak_tendon", 15, before=one(8, lambda t: 0.75 * t)),
        "axial",
        ("13",),
        ("tension",),
        lambda t: 0.25 * t,
        {"linear": 0.25},
    ),
    Trial(_case("law_null_1", 16)),
    Trial(
        _library("stiffness_hardening", 17, growth=1.0),
        "axial",
        ("all",),
        ("length",),
        None,
        {"quadratic": 0.0},
        ("stiffness_hardening",),
    ),
    Trial(_library("creep", 18, 2e-4, fraction=0.12), "axial", ("all",), ("length late",), None, {"lag": 0.0}, ("creep",)),
    Trial(
        _library("structural_friction", 19, sliding_N=0.13),
        "axial",
        ("all",),
        ("length remembered", "rate"),
        None,
        {"play": 0.0},
        ("structural_friction",),
    ),
    Trial(
        _library("external_load", 20, force_N=(0.03, -0.02, -0.02)),
        "force",
        ("s4",),
        ("position", "speed", "time"),
        None,
        {"constant": 0.0},
        ("external_load",),
    ),
    Trial(_case("law_pressure_stiffness", 21, imperfections={"pressure_stiffness": {}}), "axial", ("all",), ("length and pressure",)),
    Trial(
        _case(
            "law_wall", 22, imperfections={"tip_wall": {"stiffness_N_per_m": 5.0, "place_m": (0.04, 0.0, 0.3), "normal": (-1.0, 0.0, 0.0)}}
        ),
        "force",
        ("s4",),
        ("position",),
        None,
        {"ramp": 0.0},
    ),
    Trial(
        _case("law_hose_spring", 23, imperfections={"tethered_tip": {"stiffness_N_per_m": 0.05, "place_m": (0.03, 0.0, 0.36)}}),
        "force",
        ("s4",),
        ("position",),
        None,
        {"linear": 0.0},
    ),
    Trial(
        _case("law_drag", 24, imperfections={"tip_drag": {"size_N_s2_per_m2": 0.5}}),
        "force",
        ("s4",),
        ("speed",),
        None,
        {"quadratic": 0.0},
    ),
    Trial(
        _library("rigid_plates", 25, clamped_length_m=0.00556),
        "stiffness",
        ("body",),
        ("height",),
        None,
        {},
        ("rigid_plates",),
    ),
    Trial(
        _case("law_soft_module", 26, imperfections={"soft_part": {"loss": 0.06, "first": 7, "last": 12}}),
        "stiffness",
        ("body",),
        ("height",),
    ),
    Trial(
        _library("sensor_offset", 27, 2e-4, offset_m={"s3": (0.005, -0.004, 0.003)}),
        "measurement",
        ("s3",),
        ("position", "rate", "time"),
        None,
        {"constant": 0.0},
        ("sensor_offset",),
    ),
    Trial(_case("law_curved_lens", 28, after=curved_lens), "measurement", ("all",), ("position",), None, {}, ("field_distortion",)),
    Trial(_case("law_filtered_tip", 29, after=filtered_tip), "measurement", ("s4",), ("rate",), None, {"linear": -0.12}),
    Trial(_case("law_null_2", 30, noise=5e-4)),
)

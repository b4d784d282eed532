"""Causes that the library of effects knows, as the rig has them: in other functional forms, with sizes and shapes that are drawn.

Adding a cause is one entry of `LIBRARY`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.studies.blind.excitation import COUNT, Excitation
from tepm_opt.studies.blind.machine import Commands, Deviation

MUSCLES = ("11", "12", "13", "21", "22", "23")
POINTS = ("s1", "s2", "s3", "s4")
PULLED = 0.1  # N, from which a tendon shows that it slipped


def no_sizes(size: float) -> dict[str, float]:
    """Nothing: parameters of the rig's form are not those of the model's."""
    return {}


Alike = Callable[[Sequence[Excitation], Sequence[bool]], tuple[str, ...]]
"""Names of what looks the same in runs to fit to, in some of which a cause acts."""


@dataclass(frozen=True)
class Form:
    """A cause with everything drawn but its size.

    Attributes:
        names: that are right for it, in SPEC's vocabulary; none where it has no name.
        at: the machine with a size of it.
        usual, low, high: sizes: to begin with, the smallest and the largest that make sense.
        detail: by name, which actuator, point or parameter.
        sizes: parameters of the model's effects by full name that mean the same, at a size.
        allowed: names that are not wrong, though nobody has to find them.
        alike: names of what looks the same in the runs of a trial, some of which it acts in: as right as its own.
    """

    names: tuple[str, ...]
    at: Callable[[float], Deviation]
    usual: float
    low: float
    high: float
    detail: Mapping[str, str] = field(default_factory=dict)
    sizes: Callable[[float], dict[str, float]] = no_sizes
    allowed: tuple[str, ...] = ()
    alike: Alike = lambda runs, acting: ()


Cause = Callable[[np.random.Generator], Form]


def direction(random: np.random.Generator, axes: int = 3) -> np.ndarray:
    """A unit vector of any direction, (axes,)."""
    drawn = random.normal(size=axes)
    return drawn / np.linalg.norm(drawn)


def make_setpoint_change(change: Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]) -> Commands:
    """Wrap a function of time (rows,), pressures and tensions (rows, 6) as a change of set points, within the actuators' limits."""

    def change_setpoints(asked: SetPoints) -> SetPoints:
        pressures, tensions = change(asked.time, asked.inputs[:, :COUNT], asked.inputs[:, COUNT:])
        return SetPoints(asked.time, np.hstack([np.clip(pressures, 0.0, 0.5e6), np.clip(tensions, 0.0, 7.0)]), asked.tip_force)

    return change_setpoints


def _rig(name: str, usual: float, low: float, high: float, settings: Callable[[np.random.Generator], Callable[[float], dict[str, Any]]],
         **same: float) -> Cause:  # fmt: skip
    """A cause that is an imperfection of the rig, with no detail.

    Args:
        name: of the effect and of the imperfection.
        usual, low, high: sizes, see `Form`.
        settings: drawn; the imperfection's settings at a size.
        same: parameters of the effect that are the size times these.
    """

    def cause(random: np.random.Generator) -> Form:
        at = settings(random)
        return Form(
            (name,),
            lambda size: Deviation({name: at(size)}),
            usual,
            low,
            high,
            sizes=lambda size: {f"{name}.{each}": factor * size for each, factor in same.items()},
        )

    return cause


def _vary_setting(key: str, **others: Any) -> Callable[[float], dict[str, Any]]:
    """Make settings of an imperfection by its size, which is the one named `key`."""
    return lambda size: {key: size, **others}


def _payload(random: np.random.Generator) -> Callable[[float], dict[str, Any]]:
    beside = tuple(random.uniform(-0.006, 0.006, 2))
    return lambda size: {"mass_kg": size, "eccentricity_m": beside}


def _friction(random: np.random.Generator) -> Callable[[float], dict[str, Any]]:
    return _vary_setting("sliding_N", bristle_stiffness_N_per_m=random.uniform(3e3, 6e3), breakaway_ratio=random.uniform(1.0, 1.3))


def _hysteresis(random: np.random.Generator) -> Callable[[float], dict[str, Any]]:
    return _vary_setting("width_Pa", operators=int(random.integers(3, 9)), asymmetry=random.choice([0.0, random.uniform(-0.6, 0.6)]))


def _slack(random: np.random.Generator) -> Callable[[float], dict[str, Any]]:
    return _vary_setting("length_m", winding_stiffness_N_per_m=random.uniform(6.0, 20.0))


def _dead_zone(random: np.random.Generator) -> Callable[[float], dict[str, Any]]:
    softness = random.uniform(0.05, 0.2)
    return lambda size: {"threshold_Pa": size, "softness_Pa": max(softness * size, 1.0)}


def _mass_distribution(random: np.random.Generator) -> Form:
    name, holders = "mass_distribution", random.uniform(0.15, 0.45)
    return Form(
        (name,),
        lambda size: Deviation({name: {"fraction": size, "holder_share": holders}}),
        0.1,
        1e-3,
        0.6,
        sizes=lambda size: {f"{name}.plates": (1 - holders) * size, f"{name}.holders": holders * size},
    )


def _lag(random: np.random.Generator) -> Form:
    name, ratio = "regulator_lag", random.uniform(1.0, 3.0)
    return Form(
        (name,),
        lambda size: Deviation({name: {"fill_s": size, "exhaust_s": ratio * size}}),
        0.06,
        1e-3,
        0.5,
        sizes=lambda size: {f"{name}.filling_time": size, f"{name}.exhausting_time": ratio * size},
    )


def _gain(random: np.random.Generator) -> Form:
    name, which, sign = "actuator_gain", str(random.choice(MUSCLES)), float(random.choice([1, 1, -1]))
    return Form(
        (name,),
        lambda size: Deviation({name: {"loss": {which: sign * size}}}),
        0.05,
        1e-3,
        0.5,
        {name: which},
        lambda size: {f"{name}[{which}].loss": sign * size},
    )


def _actuator_offset(random: np.random.Generator) -> Form:
    name, which, sign = "actuator_offset", str(random.choice(MUSCLES)), float(random.choice([-1, 1]))
    if random.uniform() < 0.5:
        full = f"{name}[{which}].pressure"
        zero = lambda size: Deviation({name: {"zero_Pa": {which: sign * size}}})  # noqa: E731
        return Form((name,), zero, 4e3, 50.0, 5e4, {name: which}, lambda size: {full: sign * size})
    return Form((name,), lambda size: Deviation({name: {"length_m": {which: sign * size}}}), 1e-3, 1e-5, 0.02, {name: which})


def _leak(random: np.random.Generator) -> Form:
    name, which = "regulator_leak", str(random.choice(MUSCLES))
    critical = random.uniform(0.1, 0.5)
    settings = {"time_s": 1e-3, "critical_ratio": critical}  # a valve that lags behind the others would be another cause
    return Form((name,), lambda size: Deviation({name: {"share": {which: size}, **settings}}), 0.02, 1e-4, 0.4, {name: which})


def _tension_gain(random: np.random.Generator) -> Form:
    """A scale that is off and, half of the time, bends by up to half as much."""
    name, which, sign = "tension_gain", str(random.choice(MUSCLES)), float(random.choice([-1, 1]))
    bend = float(random.choice([0.0, random.uniform(-0.5, 0.5)]))
    same = {} if bend else {f"{name}[{which}].loss": sign}
    return Form(
        (name,),
        lambda size: Deviation({name: {"loss": {which: sign * size}, "bend": float(np.clip(bend * size, -0.2, 0.2))}}),
        0.1,
        1e-3,
        0.8,
        {name: which},
        lambda size: {full: factor * size for full, factor in same.items()},
        alike=lambda runs, acting: () if acting[0] or not acting[-1] else ("tendon_slip",),
    )


def _choked_filling(random: np.random.Generator) -> Form:
    """A valve through which no more than so much flows: the lag of large steps."""
    band, critical = random.uniform(1e4, 4e4), random.uniform(0.2, 0.5)
    at = _vary_setting("rate_per_s", band_Pa=band, critical_ratio=critical)
    return Form(("regulator_lag",), lambda size: Deviation({"choked_filling": at(1 / size)}), 0.2, 0.011, 20.0)


def _scatter(random: np.random.Generator) -> Callable[[float], dict[str, Any]]:
    draw, length = int(random.integers(2**31)), random.uniform(0.01, 0.04)  # m a part of the area
    return lambda size: {"area_spread": size, "length_spread_m": length * size, "draw": draw}


def _tendon_friction(random: np.random.Generator) -> Form:
    """Tendon friction without motion of the muscle: the tension at the end plays within a constant and a share around the motor's."""
    name, share = "tendon_friction", random.uniform(0.3, 1.5)  # of the tension, a newton of the constant

    def deviate_by(size: float) -> Deviation:
        constant, part = size, min(share * size, 0.8)

        def play_tensions(time: np.ndarray, pressures: np.ndarray, tensions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            ends = tensions.copy()
            for last, now in pairwise(ends):
                now[:] = np.clip(last, np.maximum((1 - part) * now - constant, 0.0), (1 + part) * now + np.minimum(now, constant))
            return pressures, ends

        return Deviation(before=make_setpoint_change(play_tensions))

    return Form((name,), deviate_by, 0.1, 1e-3, 1.5, sizes=lambda size: {f"{name}.constant": size, f"{name}.share": min(share * size, 0.8)})


def _load(random: np.random.Generator) -> Form:
    name, toward = "external_load", direction(random)
    return Form(
        (name,),
        lambda size: Deviation({name: {"force_N": tuple(size * toward)}}),
        0.02,
        1e-4,
        0.5,
        sizes=lambda size: {f"{name}.{axis}": float(part) for axis, part in zip("xyz", size * toward, strict=True)},
    )


def _tilt(random: np.random.Generator) -> Form:
    name, about = "base_tilt", direction(random, 2)
    return Form(
        (name,),
        lambda size: Deviation({name: {"rotation_deg": tuple(size * about)}}),
        1.0,
        1e-2,
        10.0,
        sizes=lambda size: {f"{name}.{axis}": float(part) for axis, part in zip("xy", np.deg2rad(size * about), strict=True)},
    )


def _misalignment(random: np.random.Generator) -> Form:
    name, about, along = "sensor_misalignment", direction(random), direction(random) * random.uniform(0.0, 5e-3)  # m a degree

    def sizes(size: float) -> dict[str, float]:
        turns = zip("xyz", np.deg2rad(size * about), size * along, strict=True)
        return {f"{name}.{kind}_{axis}": float(v) for axis, *both in turns for kind, v in zip(("rotation", "shift"), both, strict=True)}

    return Form(
        (name,),
        lambda size: Deviation({name: {"rotation_deg": tuple(size * about), "shift_m": tuple(size * along)}}),
        1.0,
        1e-2,
        10.0,
        sizes=sizes,
    )


def _offset(random: np.random.Generator) -> Form:
    name, which, toward = "sensor_offset", str(random.choice(POINTS)), direction(random)
    return Form((name,), lambda size: Deviation({name: {"offset_m": {which: tuple(size * toward)}}}), 3e-3, 1e-4, 0.03, {name: which})


def _warm_up(random: np.random.Generator) -> Form:
    """Muscles that become softer, or stiffer, in proportion to time until they are warm."""
    full, sign = float(random.uniform(20.0, 90.0)), float(random.choice([-1, -1, 1]))
    return Form(("warm_up",), lambda size: Deviation({"warm_up": {"change": sign * size, "full_s": full}}), 0.05, 1e-3, 0.4)


def _tracker_drift(random: np.random.Generator) -> Form:
    """A pose that goes along a slow sine, of which a session sees a part."""
    about, along, period = direction(random), direction(random) * random.uniform(0.0, 5e-3), float(random.uniform(400.0, 2000.0))

    def deviate_by(size: float) -> Deviation:
        settings = {"rotation_deg": tuple(size * about), "shift_m": tuple(size * along), "period_s": period}
        return Deviation({"tracker_drift": settings})

    return Form(("tracker_drift",), deviate_by, 1.0, 1e-2, 20.0)


def _tendon_slip(random: np.random.Generator) -> Form:
    """One tendon that slides in its clamp."""
    name, which, instant = "tendon_slip", str(random.choice(MUSCLES)), float(random.uniform(3.0, 40.0))

    def deviate_by(size: float) -> Deviation:
        return Deviation({name: {"share": {which: size}, "instant_s": instant}})

    def alike(runs: Sequence[Excitation], acting: Sequence[bool]) -> tuple[str, ...]:
        at = COUNT + MUSCLES.index(which)
        pulled = [run.began + run.setpoints.time[run.setpoints.inputs[:, at] > PULLED] for run in runs if run.role == "fit"]
        first = min((float(times[0]) for times in pulled if len(times)), default=np.inf)
        return ("tension_gain",) if first > instant else ()

    return Form((name,), deviate_by, 0.2, 1e-2, 1.0, {name: which}, lambda size: {f"{name}[{which}].share": size}, alike=alike)


def _base_vibration(random: np.random.Generator) -> Form:
    """A base, or the tracker's stand, that moves with a harmonic."""
    along, felt = direction(random), bool(random.uniform() < 0.5)
    same = {"frequency_Hz": float(random.uniform(2.0, 12.0)), "phase_deg": float(random.uniform(0.0, 360.0)), "felt": felt}
    return Form(
        ("base_vibration",), lambda size: Deviation({"base_vibration": {"amplitude_m": tuple(size * along), **same}}), 5e-4, 1e-5, 0.02
    )


def _clock_skew(random: np.random.Generator) -> Form:
    """A tracker's clock that gains more and more, or loses."""
    sign, bend = float(random.choice([-1, 1])), float(random.uniform(0.0, 0.01))  # of the rate, in a second
    return Form(
        ("clock_skew",),
        lambda size: Deviation({"clock_skew": {"rate": sign * size, "bend_per_s": sign * size * bend}}),
        3e-3,
        1e-4,
        0.05,
        sizes=lambda size: {"clock_skew.rate": sign * size} if bend < 2e-3 else {},
    )


LIBRARY: dict[str, Cause] = {
    "payload": _rig("payload", 5e-3, 1e-4, 0.1, _payload, mass=1.0),
    "mass_distribution": _mass_distribution,
    "rigid_plates": _rig("rigid_plates", 4e-3, 1e-4, 0.012, lambda random: _vary_setting("clamped_length_m")),
    "stiffness_hardening": _rig("stiffness_hardening", 1.0, 1e-2, 8.0, lambda random: _vary_setting("growth")),
    "structural_friction": _rig("structural_friction", 0.1, 1e-3, 1.5, _friction),
    "creep": _rig("creep", 0.1, 1e-3, 1.0, lambda random: _vary_setting("fraction")),
    "pressure_dead_zone": _rig("pressure_dead_zone", 15e3, 500.0, 60e3, _dead_zone),
    "pressure_hysteresis": _rig("pressure_hysteresis", 8e3, 100.0, 60e3, _hysteresis),
    "regulator_lag": _lag,
    "time_delay": _rig("time_delay", 0.03, 1e-3, 0.3, lambda random: _vary_setting("delay_s"), delay=1.0),
    "actuator_gain": _gain,
    "actuator_offset": _actuator_offset,
    "actuator_scatter": _rig("actuator_scatter", 0.02, 1e-3, 0.3, _scatter),
    "regulator_leak": _leak,
    "tension_gain": _tension_gain,
    "choked_filling": _choked_filling,
    "pressure_crosstalk": _rig("pressure_crosstalk", 0.05, 1e-3, 0.4, lambda random: _vary_setting("share")),
    "tendon_friction": _tendon_friction,
    "tendon_slack": _rig("tendon_slack", 0.03, 1e-3, 0.2, _slack),
    "external_load": _load,
    "base_tilt": _tilt,
    "sensor_misalignment": _misalignment,
    "sensor_offset": _offset,
    "warm_up": _warm_up,
    "tracker_drift": _tracker_drift,
    "tendon_slip": _tendon_slip,
    "base_vibration": _base_vibration,
    "clock_skew": _clock_skew,
}
"""By name of the effect; another form of it has a key of its own."""

OTHER_MEANING = {
    "creep": ("K_a", "alpha_2", "c_a", "m_d"),
    "rigid_plates": ("K_a", "alpha_2", "c_a", "m_d"),
    "stiffness_hardening": ("K_a", "alpha_2", "m_d"),
    "structural_friction": ("c_a",),
}
"""Parameters of the robot that mean something else beside causes whose form is not the library's: what the stiffness is at which time or
length, which part of friction is viscous; with the stiffness the mass, as weight and forces bend the body alike."""

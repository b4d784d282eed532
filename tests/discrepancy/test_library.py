"""Laws that any machine may have: each vanishes at its null and does what a formula written down apart says."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tepm_opt.discrepancy.laws.axis import AXIS, BY_DIRECTION
from tepm_opt.discrepancy.laws.effect import At, Law, Quantity
from tepm_opt.discrepancy.laws.mechanism import MECHANISM
from tepm_opt.discrepancy.laws.signals import DRIVE, INPUT, OUTPUT

SIZES = {"signal": 5.0, "time": 0.4, "force": 30.0, "speed": 0.7, "position": 0.2, "mass": 0.5, "1": 1.0}
UNITS = {"signal": "V", "time": "s", "force": "N", "speed": "m/s", "position": "m", "mass": "kg", "1": "1"}
STEP = 1e-3  # s
LAWS = {law.name: law for law in (*INPUT, *DRIVE, *AXIS, *MECHANISM, *BY_DIRECTION, *OUTPUT)}
signals, positions, speeds = st.floats(-20, 20), st.floats(-1, 1), st.floats(-3, 3)
Numbers = Mapping[str, float]


def asked(law: Law, p: Numbers, z: float = 0.0, **where: float) -> tuple[float, list[float]]:
    """What a law gives, and the rates of its states, as numbers."""
    states = [ca.SX(z)] * law.states
    after, rates = law.act(At({k: ca.SX(v) for k, v in p.items()}, states, SIZES, ca.SX(STEP), **{k: ca.SX(v) for k, v in where.items()}))
    return float(ca.evalf(ca.SX(after))), [float(ca.evalf(ca.SX(rate))) for rate in rates]


def null(law: Law) -> dict[str, float]:
    return {q.name: q.in_units(SIZES).null for q in law.quantities}


@pytest.mark.parametrize("law", [law for law in LAWS.values() if law.stage != "body"], ids=lambda law: law.name)
@given(signal=signals, z=signals)
def test_signals_are_left_alone_at_the_null(law: Law, signal: float, z: float) -> None:
    assert asked(law, null(law), z, signal=signal)[0] == signal


@pytest.mark.parametrize("law", [*AXIS, *BY_DIRECTION], ids=lambda law: law.name)
@given(position=positions, speed=speeds)
def test_axes_are_left_alone_at_the_null(law: Law, position: float, speed: float) -> None:
    force, rates = asked(law, null(law), position=position, speed=speed)
    assert force == 0.0
    assert rates == [0.0] * law.states  # states of axes begin at 0 and stay there


FORMULAS: dict[str, Callable[[Numbers, float, float], float]] = {
    "dry_friction": lambda p, q, v: -p["force"] * np.tanh(v / (0.01 * 0.7)),
    "constant_force": lambda p, q, v: p["force"],
    "stribeck_friction": lambda p, q, v: -p["force"] * np.tanh(v / 0.007) * np.exp(-((v / p["speed"]) ** 2)),
    "quadratic_drag": lambda p, q, v: -p["force"] * np.sign(v) * v**2 / 0.49,
    "asymmetric_dry_friction": lambda p, q, v: -p["force"] * np.tanh(v / 0.007) ** 2,
    "asymmetric_viscous_friction": lambda p, q, v: -p["force"] * abs(v) / 0.7,
    "quadratic_spring": lambda p, q, v: -p["force"] * q**2 / 0.04,
    "cubic_spring": lambda p, q, v: -p["force"] * q**3 / 0.008,
}


@pytest.mark.parametrize("name", FORMULAS)
@given(position=positions, speed=speeds, strength=st.floats(0.0, 300.0), shape=st.floats(0.01, 1.0))
def test_forces(name: str, position: float, speed: float, strength: float, shape: float) -> None:
    p = {"force": strength, "speed": shape}
    expected = FORMULAS[name](p, position, speed)
    assert asked(LAWS[name], p, position=position, speed=speed)[0] == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("name", ["dry_friction", "stribeck_friction", "quadratic_drag"])
@given(speed=speeds, strength=st.floats(0.0, 300.0))
def test_what_is_against_the_motion_takes_power(name: str, speed: float, strength: float) -> None:
    assert asked(LAWS[name], {"force": strength, "speed": 0.1}, speed=speed)[0] * speed <= 0.0


@given(speed=speeds, z=signals, stiffness=st.floats(0, 1e3), closing=st.floats(0, 1e2), opening=st.floats(-1e2, 1e2))
def test_hysteresis_is_bouc_and_wens(speed: float, z: float, stiffness: float, closing: float, opening: float) -> None:
    """Its state is the force itself; γ|v|z + δ v|z| with exponent 1."""
    p = {"stiffness": stiffness, "closing": closing, "opening": opening}
    force, (rate,) = asked(LAWS["hysteresis"], p, z, speed=speed)
    assert force == -z
    terms = (stiffness * speed, -closing * abs(speed) * z, -opening * speed * abs(z))
    assert rate == pytest.approx(sum(terms), abs=1e-12 * max(1.0, *map(abs, terms)))


@given(
    way=st.floats(-1.0, 1.0),
    stiffness=st.floats(1.0, 1e3),
    closing=st.floats(0.1, 1e2),
    opening=st.floats(-1e2, 1e2),
    part=st.floats(-0.99, 0.99),
)
def test_hysteresis_is_passive_within_its_range(way: float, stiffness: float, closing: float, opening: float, part: float) -> None:
    """No more power comes out than a storage that depends on the state alone gives: dS/dt <= z v, wherever z may come to."""
    reach = min(stiffness / max(closing + opening, 1e-12), 1e3)
    z = part * reach
    _, (rate,) = asked(LAWS["hysteresis"], {"stiffness": stiffness, "closing": closing, "opening": opening}, z, speed=way)
    slope = z / (stiffness - opening * abs(z))  # S'(z)
    assert slope * z >= 0
    assert slope * rate <= z * way + 1e-9 * abs(z)
    assert all(q.low > 0 for q in LAWS["hysteresis"].quantities if q.name == "closing"), "without closing there is no loop"


@given(position=positions, speed=speeds, strength=st.floats(0.0, 300.0))
def test_linear_elements_are_passive(position: float, speed: float, strength: float) -> None:
    spring = asked(LAWS["linear_spring"], {"stiffness": strength}, position=position, speed=speed)[0]
    damper = asked(LAWS["linear_damper"], {"damping": strength}, position=position, speed=speed)[0]
    assert spring == -strength * position
    assert damper == -strength * speed
    assert all(q.low == 0 for law in MECHANISM for q in law.quantities)


@pytest.mark.slow
def test_hysteresis_closes_a_loop_that_ends_at_stiffness_over_closing() -> None:
    """Under a long way in one direction the force tends to stiffness / (closing + opening)."""
    law, z, p = LAWS["hysteresis"], 0.0, {"stiffness": 200.0, "closing": 15.0, "opening": 5.0}
    for _ in range(5000):
        z += 1e-3 * asked(law, p, z, speed=0.3)[1][0]
    assert z == pytest.approx(200.0 / 20.0, rel=1e-6)


@pytest.mark.parametrize("name", ["input_lag", "sensor_lag"])
@given(signal=signals, z=signals, time=st.floats(1e-4, 10.0))
def test_lags_are_of_first_order(name: str, signal: float, z: float, time: float) -> None:
    after, (rate,) = asked(LAWS[name], {"time": time}, z, signal=signal)
    if time < 2 * STEP:  # too fast for the steps: no lag
        assert after == signal
    else:
        assert after == z
        assert rate == pytest.approx((signal - z) / time, rel=1e-9, abs=1e-12)


@given(signal=signals, z=signals, filling=st.floats(0.01, 10.0), exhausting=st.floats(0.01, 10.0))
def test_unequal_lag_knows_its_direction(signal: float, z: float, filling: float, exhausting: float) -> None:
    after, (rate,) = asked(LAWS["unequal_lag"], {"filling": filling, "exhausting": exhausting}, z, signal=signal)
    assert after == z
    assert rate == pytest.approx((signal - z) / (filling if signal > z else exhausting), rel=1e-9, abs=1e-12)


@given(signal=signals, part=st.floats(0, 1), offset=signals)
def test_gains_offsets_and_dead_zones(signal: float, part: float, offset: float) -> None:
    assert asked(LAWS["input_gain"], {"loss": part}, signal=signal)[0] == pytest.approx(signal - part * signal, abs=1e-12)
    assert asked(LAWS["sensor_gain"], {"gain": part}, signal=signal)[0] == pytest.approx(signal + part * signal, abs=1e-12)
    for name in ("input_offset", "sensor_offset"):
        assert asked(LAWS[name], {"offset": offset}, signal=signal)[0] == pytest.approx(signal + offset, abs=1e-12)
    width = 5.0 * part
    expected = 0.0 if abs(signal) <= width else signal - np.sign(signal) * width
    assert asked(LAWS["input_dead_zone"], {"width": width}, signal=signal)[0] == pytest.approx(expected, abs=1e-12)


@given(signal=signals, tightness=st.floats(0.01, 10.0))
def test_saturation_cuts_at_the_size_over_the_tightness(signal: float, tightness: float) -> None:
    assert asked(LAWS["sensor_saturation"], {"tightness": tightness}, signal=signal)[0] == pytest.approx(min(signal, 5.0 / tightness))


class TestCandidates:
    @pytest.mark.parametrize("law", LAWS.values(), ids=lambda law: law.name)
    def test_what_is_worth_a_try_is_within_the_range_and_not_the_null(self, law: Law) -> None:
        candidate, free = law.place_on("part", SIZES, UNITS)
        assert candidate.label == f"{law.name}[part]"
        assert set(candidate.null) == {each.name for each in free.values()}
        assert set(candidate.shapes) < set(candidate.null), "something must tell the strength"
        assert len({tuple(sorted(probe.items())) for probe in candidate.probes}) == len(candidate.probes)
        for probe in candidate.probes:
            assert any(probe[name] != candidate.null[name] for name in probe if name not in candidate.shapes)
            for each in free.values():
                assert each.low <= probe[each.name] <= each.high
                assert each.low <= candidate.null[each.name] <= each.high
        for each in free.values():
            assert each.unit
            assert each.scale > 0

    def test_strengths_vary_in_every_shape(self) -> None:
        candidate, _ = LAWS["stribeck_friction"].place_on("a", SIZES, UNITS)
        forces = {probe["stribeck_friction[a].force"] for probe in candidate.probes}
        speeds_tried = {probe["stribeck_friction[a].speed"] for probe in candidate.probes}
        assert len(candidate.probes) == len(forces) * len(speeds_tried)
        assert len(forces) > 1 < len(speeds_tried)

    @given(st.floats(1e-9, 1e9), st.floats(1e-9, 1e9))
    def test_quantities_go_with_their_sizes(self, force: float, position: float) -> None:
        q = Quantity("stiffness", "force/position", 0.5, (0.1, 1.0), -2.0, 100.0).in_units({"force": force, "position": position})
        unit = force / position
        assert (q.null, q.low, q.high) == pytest.approx((0.5 * unit, -2 * unit, 100 * unit))
        assert q.probes == pytest.approx((0.1 * unit, unit))

    def test_names_are_told_once(self) -> None:
        assert len(LAWS) == len((*INPUT, *DRIVE, *AXIS, *MECHANISM, *BY_DIRECTION, *OUTPUT))
        for law in LAWS.values():
            assert law.explains
            assert set(law.beside) <= set(LAWS)


@given(signal=signals, tightness=st.floats(0.1, 10))
def test_saturation_holds_both_ways(signal: float, tightness: float) -> None:
    assert asked(LAWS["input_saturation"], {"tightness": tightness}, signal=signal)[0] == pytest.approx(
        np.clip(signal, -5 / tightness, 5 / tightness)
    )


@pytest.mark.slow
def test_play_drags_its_signal_along() -> None:
    """Back and forth, against the play operator; and never further off than the play."""
    width, time = 0.8, np.arange(0, 4, STEP)
    signal = 3 * np.sin(2 * np.pi * time) * np.exp(-time / 2)
    exact, z, acts = np.zeros(len(time)), 0.0, []
    for k, u in enumerate(signal):
        exact[k] = np.clip(exact[k - 1] if k else 0.0, u - width, u + width)
        dragged, (rate,) = asked(LAWS["backlash"], {"width": width}, z, signal=float(u))
        z += STEP * rate
        acts.append(dragged)
    assert np.abs(np.array(acts) - exact).max() < 0.05
    assert np.abs(np.array(acts) - signal).max() <= width + 1e-9


def test_what_is_compliant_swings() -> None:
    """A step, against the textbook's response of second order."""
    period, damping, z = 0.1, 0.2, np.zeros(2)
    law, p, found = LAWS["compliance"], {"time": 0.1, "damping": 0.2}, []
    rates = ca.Function(
        "rates",
        [s := ca.SX.sym("z", 2)],
        [ca.vertcat(*law.act(At({k: ca.SX(v) for k, v in p.items()}, ca.vertsplit(s), SIZES, ca.SX(STEP), signal=ca.SX(1.0)))[1])],
    )
    for _ in range(1000):
        k_1 = np.asarray(rates(z)).ravel()
        z = z + STEP * np.asarray(rates(z + STEP / 2 * k_1)).ravel()
        found.append(z[0])
    time, w = np.arange(1, 1001) * STEP, np.sqrt(1 - damping**2) / period
    exact = 1 - np.exp(-damping * time / period) * (np.cos(w * time) + damping / (w * period) * np.sin(w * time))
    assert np.abs(np.array(found) - exact).max() < 1e-3

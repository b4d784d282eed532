"""Laws of pressures, vessels and soft bodies: nothing at the null, and what formulas written down apart say."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.adapters.equations import Equations
from tepm_opt.discrepancy.laws.effect import At, Law
from tepm_opt.discrepancy.laws.pneumatics import PNEUMATICS
from tepm_opt.discrepancy.laws.soft import SOFT
from tepm_opt.discrepancy.laws.vessels import VESSEL
from tepm_opt.errors import InputError

SIZES = {"signal": 5.0, "time": 0.4, "force": 30.0, "speed": 0.7, "position": 0.2, "1": 1.0}
UNITS = {"signal": "Pa", "time": "s", "force": "N", "speed": "m/s", "position": "m", "1": "1"}
STEP = 1e-3  # s
LAWS = {law.name: law for law in (*PNEUMATICS, *SOFT)}
pressures, times = st.floats(0.0, 20.0), st.floats(0.02, 10.0)


def asked(law: Law, p: Mapping[str, float], z: float = 0.0, **where: float) -> tuple[np.ndarray, list[float]]:
    """What a law gives, and the rates of its states, as numbers."""
    at = At({k: ca.SX(v) for k, v in p.items()}, [ca.SX(z)] * law.states, SIZES, ca.SX(STEP), **{k: ca.SX(v) for k, v in where.items()})
    after, rates = law.act(at)
    return np.asarray(ca.evalf(ca.SX(after))).ravel(), [float(ca.evalf(ca.SX(rate))) for rate in rates]


def null(law: Law) -> dict[str, float]:
    return {q.name: q.in_units(SIZES).null for q in law.quantities}


@pytest.mark.parametrize("law", PNEUMATICS, ids=lambda law: law.name)
@given(pressure=pressures, z=pressures)
def test_pressures_are_left_alone_at_the_null(law: Law, pressure: float, z: float) -> None:
    assert asked(law, null(law), z, signal=pressure)[0] == pressure


@pytest.mark.parametrize("law", [*SOFT, *VESSEL], ids=lambda law: f"{law.name} of {law.part}")
@given(position=st.floats(-1, 5), speed=st.floats(-3, 3))
def test_bodies_and_vessels_are_left_alone_at_the_null(law: Law, position: float, speed: float) -> None:
    assert not asked(law, null(law), position=position, speed=speed)[0].any()


@given(pressure=pressures, z=pressures, filling=times, exhausting=times, chokes=st.tuples(times, times), growth=st.floats(-0.2, 5.0))
def test_a_lag_knows_its_direction_its_highest_flow_and_its_volume(
    pressure: float, z: float, filling: float, exhausting: float, chokes: tuple[float, float], growth: float
) -> None:
    p = {"filling": filling, "exhausting": exhausting, "growth": growth}
    p |= dict(zip(("filling_choke", "exhausting_choke"), chokes, strict=True))
    after, rates = asked(LAWS["pressure_lag"], p, z, signal=pressure)
    assert after == z
    volume = max(1 + growth * z / 5.0, 0.1)
    expected = np.clip((pressure - z) / (filling if pressure > z else exhausting), -5.0 / chokes[1], 5.0 / chokes[0]) / volume
    assert rates == [pytest.approx(expected, rel=1e-6, abs=1e-9)]


@given(pressure=pressures, z=pressures, filling=times, exhausting=times)
def test_without_choke_and_growth_it_is_a_lag(pressure: float, z: float, filling: float, exhausting: float) -> None:
    p = {"filling": filling, "exhausting": exhausting, "filling_choke": 0.0, "exhausting_choke": 0.0, "growth": 0.0}
    _, (rate,) = asked(LAWS["pressure_lag"], p, z, signal=pressure)
    assert rate == pytest.approx((pressure - z) / (filling if pressure > z else exhausting), rel=1e-9, abs=1e-12)


@given(loss=st.floats(0.0, 1.0))
def test_a_leak_takes_more_the_higher_the_pressure(loss: float) -> None:
    """Four times the pressure drives twice the flow."""
    low, high = (pressure - asked(LAWS["leak"], {"loss": loss}, signal=pressure)[0] for pressure in (2.0, 8.0))
    assert high == pytest.approx(2 * low, abs=1e-9)


@pytest.mark.parametrize("law", [*PNEUMATICS, *SOFT, *VESSEL], ids=lambda law: f"{law.name} of {law.part}")
def test_what_is_worth_a_try_is_within_the_range_and_not_the_null(law: Law) -> None:
    candidate, free = law.place_on("part", SIZES, UNITS)
    assert candidate.explains
    assert candidate.gauge == (law.name in {"input_gain", "input_offset"})
    for probe in candidate.probes:
        assert any(probe[name] != candidate.null[name] for name in probe if name not in candidate.shapes)
        assert all(each.low <= probe[each.name] <= each.high for each in free.values())


def test_a_creeping_body_gives_way_under_a_steady_motion() -> None:
    """A Maxwell branch moved at the speed v: F = S v T (1 - exp(-t / T)) against the motion."""
    m = Equations("a body that is moved", time=1.0, laws=SOFT)
    q = m.state("q")
    m.rate(q, 0.3)
    m.output("force", m.axis("q", q, ca.SX(0.3), force=2.0, speed=1.0, position=0.5))
    plant = m.plant().with_values({"creep[q].stiffness": 4.0, "creep[q].time": 0.7})
    time = np.linspace(0, 3, 301)
    found = plant.predict(run_of(time, np.zeros((301, 0)), 1, state=np.zeros(1))).points[:, 0, 0]
    assert found == pytest.approx(-4.0 * 0.3 * 0.7 * (1 - np.exp(-time / 0.7)), abs=1e-8)


def tanks() -> Equations:
    m = Equations("two tanks", time=10.0)
    upper, lower = m.state("upper", 1.0), m.state("lower", 1.0)
    over = m.vessel("upper", upper, m.input("pump", size=1.0) - 0.5 * upper, size=1.0)
    m.vessel("lower", lower, 0.5 * upper + over - 0.2 * lower, size=1.0, last=True)
    m.output("upper", upper)
    m.output("lower", lower)
    return m


def run_of(time: np.ndarray, inputs: np.ndarray, outputs: int, **others: object) -> Run:
    return Run("run.csv", "fit", time, inputs, np.zeros((len(time), 3)), np.zeros((len(time), outputs, 1)), **others)  # type: ignore[arg-type]


def test_what_runs_over_above_is_found_below_in_part() -> None:
    edge, flow, part, below = 1.5, 3.0, 0.4, 2.2
    plant = tanks().plant(substeps=4, between="hold")
    values = {"overflow[upper].edge": edge, "overflow[upper].flow": flow, "overflow[upper].part": part}
    plant = plant.with_values({**values, "overflow[lower].edge": below, "overflow[lower].flow": 2.0, "seepage[upper].flow": 0.05})
    assert "overflow[lower].part" not in plant.values, "nothing is below the last vessel"
    time = np.linspace(0, 20, 401)
    pump = np.where(time < 10, 2.0, 0.1)

    def rates(t: float, x: np.ndarray) -> list[float]:
        u, v = x
        over = flow * max(u - edge, 0.0)
        asked = 2.0 if t < 10 else 0.1
        return [asked - 0.55 * u - over, 0.5 * u + part * over - 0.2 * v - 2.0 * max(v - below, 0.0)]

    exact = {"method": "LSODA", "rtol": 1e-9, "atol": 1e-11, "max_step": 0.05}
    full = solve_ivp(rates, (0, 10), [1.0, 1.0], t_eval=time[:201], **exact).y
    empty = solve_ivp(rates, (10, 20), full[:, -1], t_eval=time[200:], **exact).y
    expected = np.hstack([full, empty[:, 1:]]).T
    found = plant.predict(run_of(time, pump[:, None], 2, state=np.array([1.0, 1.0]))).points[..., 0]
    assert expected[:, 0].max() > edge + 0.2
    assert expected[:, 1].max() > below
    assert found == pytest.approx(expected, abs=2e-4)


@pytest.mark.parametrize("reached", [0.2, 0.7, 1.0, 3.0, 7.0])
def test_an_edge_is_tried_just_below_whatever_level_is_reached(reached: float) -> None:
    """Nobody knows beforehand which level the model reaches: only its usual size within a factor of seven."""
    for law in (law for law in VESSEL if law.name == "overflow"):
        candidate, _ = law.place_on("tank", SIZES, UNITS)
        edges = {probe["overflow[tank].edge"] for probe in candidate.probes}
        assert any(0.7 * reached * 0.2 <= edge < reached * 0.2 for edge in edges)


def test_two_vessels_have_names_of_their_own() -> None:
    m = Equations("two tanks of one name")
    upper, lower = m.state("upper", 1.0), m.state("lower", 1.0)
    m.vessel("tank", upper, -upper, size=1.0)
    with pytest.raises(InputError, match=r"overflow\[tank\].* is there twice"):
        m.vessel("tank", lower, upper - lower, size=1.0)


def test_what_runs_over_faster_than_the_steps_is_as_fast_as_they_bear() -> None:
    plant = tanks().plant(substeps=4, between="hold").with_values({"overflow[upper].edge": 1.5, "overflow[upper].flow": 500.0})
    time = np.linspace(0, 20, 401)
    level = plant.predict(run_of(time, np.full((401, 1), 2.0), 2, state=np.array([1.0, 1.0]))).points[:, 0, 0]
    assert level.max() == pytest.approx(1.5, abs=0.02)
    assert level[-1] == pytest.approx(1.5 + (2.0 - 0.75) / 160.0, abs=1e-3)

"""Machines given by equations: motions against SciPy, derivatives against differences, inputs between samples, rest, what is refused."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.signal import lsim, resample

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.adapters.casadi_plant import CasadiPlant
from tepm_opt.discrepancy.adapters.equations import Equations
from tepm_opt.discrepancy.adapters.inputs import Between, inputs_at_steps
from tepm_opt.discrepancy.laws.axis import AXIS
from tepm_opt.discrepancy.laws.effect import Law, Quantity
from tepm_opt.discrepancy.laws.mechanism import MECHANISM
from tepm_opt.discrepancy.laws.signals import INPUT, OUTPUT
from tepm_opt.errors import InputError
from tepm_opt.solvers.mechanics.plant import START, PredictionError

TIME = np.arange(0, 3.0, 0.01)
EVERYTHING = {  # every effect of the library acts
    "input_lag[force].time": 0.1, "unequal_lag[force].filling": 0.2, "unequal_lag[force].exhausting": 0.07,
    "input_gain[force].loss": 0.1, "input_offset[force].offset": 0.3, "input_dead_zone[force].width": 0.1,
    "dry_friction[guide].force": 0.3, "constant_force[guide].force": 0.2, "quadratic_drag[guide].force": 0.1,
    "quadratic_spring[guide].force": 0.1, "cubic_spring[guide].force": 0.2, "hysteresis[guide].stiffness": 3.0,
    "hysteresis[guide].closing": 8.0, "hysteresis[guide].opening": 2.0, "sensor_lag[position].time": 0.05,
    "sensor_gain[position].gain": 0.1, "sensor_offset[position].offset": 0.02,
}  # fmt: skip


def machine(between: Between = "line", substeps: int = 1) -> CasadiPlant:
    m = Equations("a mass on a spring", time=0.5)
    q, v = m.state("q"), m.state("v")
    force = m.input("force", size=2.0, unit="N")
    mass, spring = m.parameter("mass", 1.5, "kg"), m.parameter("spring", 20.0, "N/m", within=0.5)
    m.rate(q, v)
    m.rate(v, (force - spring * q - 1.2 * v + m.axis("guide", q, v, force=2.0, speed=0.5, position=0.1)) / mass)
    m.output("position", q, "m", size=0.1)
    return m.plant(substeps, between)


def lag(between: Between = "line", substeps: int = 1, through: float = 0.0) -> CasadiPlant:
    """x' = -x / 0.3 + u, y = x + through · u."""
    m = Equations("a lag", laws=())
    x, u = m.state("x"), m.input("u", size=1.0)
    m.rate(x, -x / m.parameter("time", 0.3, "s") + u)
    m.output("y", x + through * u)
    return m.plant(substeps, between)


def run_of(time: np.ndarray, inputs: np.ndarray, **others: object) -> Run:
    return Run("run.csv", "fit", time, inputs, np.zeros((len(time), 3)), np.zeros((len(time), 1, 1)), **others)  # type: ignore[arg-type]


def pushed(time: np.ndarray = TIME, seed: int = 1, **others: object) -> Run:
    """Sums of sines, not at rest at the start."""
    random = np.random.default_rng(seed)
    signal = sum(random.normal() * np.sin(w * time + random.uniform(0, 6)) for w in (1.0, 3.0, 7.0))
    return run_of(time, np.asarray(signal)[:, None], **others)


def by_differences(plant: CasadiPlant, run: Run, name: str, step: float) -> np.ndarray:
    high, low = (plant.with_values({name: plant.values[name] + sign * step}).predict(run).points for sign in (1, -1))
    return (high - low) / (2 * step)


class TestMotion:
    @pytest.mark.slow
    def test_of_everything_against_scipy(self) -> None:
        """The laws written down a second time, integrated by SciPy."""
        run, p = pushed(start="free", state=np.array([0.05, -0.1])), EVERYTHING
        time, u = run.time, run.inputs[:, 0]

        def rates(t: float, x: np.ndarray) -> list[float]:
            q, v, z, one, two, seen = x
            asked = float(np.interp(t, time, u))
            slow = p["unequal_lag[force].filling"] if one > two else p["unequal_lag[force].exhausting"]
            acts = 0.9 * two + p["input_offset[force].offset"]
            acts -= np.clip(acts, -0.1, 0.1)
            speed, place = v / 0.5, q / 0.1
            guide = -0.3 * np.tanh(v / 0.005) + 0.2 - 0.1 * speed * abs(speed) - 0.1 * place**2 - 0.2 * place**3 - z
            d_z = 3.0 * v - 8.0 * abs(v) * z - 2.0 * v * abs(z)
            d_v = (acts - 20.0 * q - 1.2 * v + guide) / 1.5
            return [v, d_v, d_z, (asked - one) / p["input_lag[force].time"], (one - two) / slow, (q - seen) / 0.05]

        start = [0.05, -0.1, 0.0, u[0], u[0], 0.05]
        motion = solve_ivp(rates, time[[0, -1]], start, "LSODA", time, rtol=1e-9, atol=1e-12, max_step=1e-3)
        expected = 1.1 * motion.y[5] + 0.02
        found = machine(substeps=40).with_values(EVERYTHING).predict(run).points[:, 0, 0]
        assert np.ptp(expected) > 0.05
        np.testing.assert_allclose(found, expected, atol=2e-5)

    def test_is_of_fourth_order(self) -> None:
        plant, run = machine(), pushed(np.arange(0, 2.0, 0.1), start="free", state=np.array([0.05, 0.1]))
        exact = replace(plant, substeps=64).predict(run).points
        errors = [np.abs(replace(plant, substeps=n).predict(run).points - exact).max() for n in (1, 2, 4)]
        assert [round(float(np.log2(a / b)), 1) for a, b in pairwise(errors)] == pytest.approx([4.0, 4.0], abs=0.4)

    @given(st.lists(st.floats(0.002, 0.05), min_size=1, max_size=30))
    def test_samples_need_not_be_equally_far_apart(self, steps: list[float]) -> None:
        """x' = -x / 0.3 with no input has a solution in closed form."""
        time = np.concatenate([[0.0], np.cumsum(steps)])
        run = run_of(time, np.zeros((len(time), 1)), start="free", state=np.array([1.0]))
        np.testing.assert_allclose(LAG.predict(run).points[:, 0, 0], np.exp(-time / 0.3), rtol=1e-5)

    def test_one_sample(self) -> None:
        found = machine().predict(run_of(np.array([3.0]), np.array([[2.0]])), ["spring"])
        np.testing.assert_allclose(found.points, [[[0.1]]], atol=1e-12)
        np.testing.assert_allclose(found.by, [[[[-0.1 / 20.0]]]], atol=1e-12)

    def test_a_machine_without_inputs_or_parameters(self) -> None:
        m = Equations("a clock", laws=())
        x = m.state("x")
        m.rate(x, 1.0)
        m.output("x", x)
        run = run_of(TIME, np.zeros((len(TIME), 0)), start="free", state=np.array([2.0]))
        np.testing.assert_allclose(m.plant().predict(run).points[:, 0, 0], 2.0 + TIME, atol=1e-12)

    def test_a_machine_without_states(self) -> None:
        m = Equations("a lever", laws=())
        u = m.input("u", size=1.0)
        m.output("y", m.parameter("ratio", 2.0) * u)
        np.testing.assert_allclose(m.plant().predict(pushed()).points[:, 0], 2.0 * pushed().inputs, atol=1e-12)
        found = m.plant().predict(pushed(), ["ratio"])
        np.testing.assert_allclose(found.points[:, 0], 2.0 * pushed().inputs, atol=1e-12)
        np.testing.assert_allclose(found.by[0, :, 0], pushed().inputs, atol=1e-12)


LAG = lag()


class TestDerivatives:
    @pytest.mark.parametrize("start", ["rest", "state"])
    def test_by_every_parameter_against_differences(self, start: str) -> None:
        plant = machine().with_values(EVERYTHING)
        run = pushed() if start == "rest" else pushed(start="free", state=np.array([0.03, -0.2]))
        names = [*plant.known, *EVERYTHING]
        found = plant.predict(run, names)
        for k, name in enumerate(names):
            expected = by_differences(plant, run, name, 1e-6 * max(abs(plant.values[name]), 0.1))
            size = np.abs(expected).max()
            assert size > 0 or name.startswith("hysteresis"), name
            np.testing.assert_allclose(found.by[k], expected, atol=2e-4 * size + 1e-9, err_msg=name)

    def test_points_do_not_depend_on_what_is_differentiated(self) -> None:
        plant, run = machine(), pushed()
        np.testing.assert_allclose(plant.predict(run, ["mass"]).points, plant.predict(run).points, atol=1e-14)

    def test_of_several_outputs_and_substeps(self) -> None:
        m = Equations("two", laws=())
        a, b = m.state("a", 1.0), m.state("b")
        u, k = m.input("u", size=1.0), m.parameter("k", 2.0)
        m.rate(a, -k * a + u)
        m.rate(b, a * b - b + k * u)
        m.output("first", a * k)
        m.output("second", b + u)
        m.output("third", a - b)
        plant, run = m.plant(substeps=3), pushed(start="free", state=np.array([0.2, -0.4]))
        run = replace(run, points=np.zeros((run.rows, 3, 1)))
        found = plant.predict(run, ["k", START + "b"])
        assert found.points.shape == (len(TIME), 3, 1)
        np.testing.assert_allclose(found.by[0], by_differences(plant, run, "k", 1e-6), atol=1e-6)
        high, low = (plant.predict(replace(run, state=np.array([0.2, -0.4 + d]))).points for d in (1e-6, -1e-6))
        np.testing.assert_allclose(found.by[1], (high - low) / 2e-6, atol=1e-6)


class TestInputsBetweenSamples:
    def test_hold_is_exact_for_steps(self) -> None:
        """Zero-order hold of a first-order lag in closed form, and what goes straight through is of the sample itself."""
        u = np.random.default_rng(2).normal(size=40)
        expected, x = [], 0.3 * u[0]
        for value in u:
            expected.append(x + 2 * value)
            x = 0.3 * value + (x - 0.3 * value) * np.exp(-0.1 / 0.3)
        found = lag("hold", 8, through=2.0).predict(run_of(0.1 * np.arange(40), u[:, None])).points[:, 0, 0]
        np.testing.assert_allclose(found, expected, atol=1e-7)

    def test_line_is_exact_for_lines(self) -> None:
        time, u = 0.1 * np.arange(40), np.random.default_rng(2).normal(size=40)
        _, expected, _ = lsim(([[-1 / 0.3]], [[1.0]], [[1.0]], [[0.0]]), u, time, [0.3 * u[0]])
        found = lag("line", 8).predict(run_of(time, u[:, None])).points[:, 0, 0]
        np.testing.assert_allclose(found, expected, atol=1e-7)

    def test_band_knows_what_fast_signals_do_between_samples(self) -> None:
        """A sine sampled 3.3 times a period: the steady answer in closed form, far better than straight lines."""
        time, w = 0.1 * np.arange(300), 2 * np.pi * 3.0
        run, gain = run_of(time, np.sin(w * time)[:, None]), 1 / (1 / 0.3 + 1j * w)
        expected = np.abs(gain) * np.sin(w * time + np.angle(gain))
        middle = slice(100, 200)
        errors = {
            between: np.abs(lag(between, 8).predict(run).points[middle, 0, 0] - expected[middle]).max() / np.abs(gain)
            for between in ("hold", "line", "band")
        }
        assert errors["band"] < 0.02, errors
        assert errors["line"] > 0.2, errors
        assert errors["hold"] > 0.5, errors

    def test_band_goes_through_the_samples(self) -> None:
        run = run_of(0.1 * np.arange(50), resample(np.random.default_rng(1).normal(size=10), 50)[:, None])
        inputs = inputs_at_steps(run.time, run.inputs, (), "band", 4)
        np.testing.assert_allclose(inputs[:, 0], run.inputs[:-1, 0], atol=1e-3)
        np.testing.assert_array_equal(inputs[:, -1], run.inputs[1:, 0])


class TestRest:
    def test_is_where_rates_vanish(self) -> None:
        """Hardening spring: the real root of 20 q + 200 q³ = 2."""
        plant = machine().with_values({"cubic_spring[guide].force": 0.2})
        run = run_of(TIME[:5], np.full((5, 1), 2.0))
        found = plant.predict(run).points[:, 0, 0]
        roots = np.roots([0.2 / 0.1**3, 0, 20.0, -2.0])
        np.testing.assert_allclose(found, float(roots[np.abs(roots.imag) < 1e-9].real[0]), atol=1e-10)

    @pytest.mark.parametrize("unit", [1e-9, 1e-3, 1.0, 1e6, 1e11])
    def test_does_not_depend_on_units(self, unit: float) -> None:
        """The same machine with its position in other units."""
        m = Equations("scaled", laws=())
        q, v, u = m.state("q"), m.state("v"), m.input("u", size=1.0)
        m.rate(q, v)
        m.rate(v, u * unit - 20.0 * q - 200.0 * q * (q / unit) ** 2 - 1.2 * v)
        m.output("q", q)
        run = run_of(TIME[:50], np.full((50, 1), 2.0))
        root = np.roots([200.0, 0, 20.0, -2.0])
        expected = unit * float(root[np.abs(root.imag) < 1e-9].real[0])
        np.testing.assert_allclose(m.plant().predict(run).points[:, 0, 0], expected, rtol=1e-8)

    def test_filters_begin_at_rest_too(self) -> None:
        plant = machine().with_values({"input_lag[force].time": 0.3, "sensor_lag[position].time": 0.2})
        run = run_of(TIME, np.full((len(TIME), 1), 2.0))
        np.testing.assert_allclose(plant.predict(run).points[:, 0, 0], 0.1, atol=1e-9)

    def test_is_found_where_speeds_are_zero_but_for_rounding(self) -> None:
        """Speeds of 1e-33 rad/s, of which a relative tolerance wants a millionth: one start in fifteen was refused."""
        m = Equations("a hose", laws=())
        q, v = ca.vertcat(m.state("a"), m.state("b")), ca.vertcat(m.state("rate a"), m.state("rate b"))
        pull = ca.vertcat(m.input("u", size=1.0), m.input("w", size=1.0))
        height = -0.3 * (1 - 0.2 * ca.sumsqr(q))
        rates = (m.parameter("stiffness", 1.8, "N m/rad") * (pull - q) - 1.5 * ca.gradient(height, q) - 0.02 * v) / 0.0037
        for k in range(2):
            m.rate(q[k], v[k])
            m.rate(v[k], rates[k])
            m.output(f"q{k}", q[k])
        plant, random = m.plant(), np.random.default_rng(1)
        for first in random.normal(0.0, 0.2, (200, 2)):
            found = plant.predict(Run("r", "fit", TIME[:2], np.tile(first, (2, 1)), np.zeros((2, 3)), np.zeros((2, 2, 1)))).points[..., 0]
            np.testing.assert_allclose(found, np.tile(first * 1.8 / (1.8 + 1.5 * 0.12), (2, 1)), rtol=1e-9)

    @pytest.mark.parametrize(
        ("rate", "says"),
        [
            (lambda v, u: 0 * v, "comes to rest wherever it is"),
            (lambda v, u: -v, "comes to rest wherever it is"),
            (lambda v, u: u, "does not come to rest"),
            (lambda v, u: ca.sqrt(v - 1), "does not come to rest"),
        ],
        ids=["glides", "drags", "is driven", "not a number"],
    )
    def test_what_has_none_says_so(self, rate: Callable[[ca.SX, ca.SX], ca.SX], says: str) -> None:
        m = Equations("a sled", laws=())
        q, v, u = m.state("q"), m.state("v"), m.input("u", size=1.0)
        m.rate(q, v)
        m.rate(v, rate(v, u))
        m.output("q", q)
        with pytest.raises(PredictionError, match=rf'run\.csv: a sled {says} under the first inputs; valid: start = "measured" or "free"'):
            m.plant().predict(run_of(TIME, np.ones((len(TIME), 1))))


class TestOwnLaws:
    """Laws placed by `Equations.effect` and masses by `Equations.mass`."""

    def hanging(self) -> CasadiPlant:
        """A mass on a spring and on a law that no library has; upwards."""
        m = Equations("hanging", laws=MECHANISM)
        q, v = m.state("q"), m.state("v")
        stiffness = Quantity("stiffness", "force/position", 0.0, (0.1, 1.0), 0.0, 10.0)
        stop = Law("stop", "body", (stiffness,), lambda at: (at.p["stiffness"] * ca.fmax(-at.position, 0), []))
        mass = 2.0 + m.mass("hook", size=0.5)
        m.rate(q, v)
        push = m.effect(stop, "floor", {"force": 10.0, "position": 0.02}, {"force": "N", "position": "m"}, position=q + 0.1)
        m.rate(v, (-100.0 * q - 5.0 * v + push) / mass - 9.81)
        m.output("q", q, "m")
        return m.plant()

    def at_rest(self, plant: CasadiPlant) -> float:
        return float(plant.predict(run_of(TIME[:2], np.zeros((2, 0)))).points[0, 0, 0])

    def test_have_names_units_and_ranges_as_the_library_has(self) -> None:
        plant = self.hanging()
        assert [candidate.label for candidate in plant.candidates] == ["payload[hook]", "stop[floor]"]
        mass, stop = plant.parameters["payload[hook].mass"], plant.parameters["stop[floor].stiffness"]
        assert (mass.unit, mass.low, mass.high, mass.start) == ("kg", 0.0, 5.0, 0.0)
        assert (stop.unit, stop.low, stop.high, stop.start) == ("N/m", 0.0, 5000.0, 0.0)

    def test_act_where_the_equations_ask_for_them(self) -> None:
        plant = self.hanging()
        assert self.at_rest(plant) == pytest.approx(-2.0 * 9.81 / 100)
        mass = {"payload[hook].mass": 0.5}
        assert self.at_rest(plant.with_values(mass)) == pytest.approx(-2.5 * 9.81 / 100)
        stop = {"stop[floor].stiffness": 400.0}  # 100 q + 400 (q + 0.1) = -2 g
        assert self.at_rest(plant.with_values(stop)) == pytest.approx((-2.0 * 9.81 - 40.0) / 500)

    def test_without_a_size_are_refused(self) -> None:
        m = Equations("hanging")
        law = Law("stop", "body", (Quantity("stiffness", "force/position", 0.0, (1.0,), 0.0, 10.0),), lambda at: (at.p["stiffness"], []))
        with pytest.raises(InputError, match=r"hanging: stop\[floor\]: size of 'position' is missing; valid: force, position"):
            m.effect(law, "floor", {"force": 1.0})

    def test_that_are_left_out_are_no_mass(self) -> None:
        m = Equations("bare", laws=())
        assert float(m.mass("hook", size=1.0)) == 0.0


class TestRefusals:
    def test_a_motion_without_bounds(self) -> None:
        m = Equations("a needle on its tip", laws=())
        q, v = m.state("q"), m.state("v")
        m.rate(q, v)
        m.rate(v, 1e4 * q)
        m.output("q", q)
        run = run_of(TIME, np.zeros((len(TIME), 0)), start="free", state=np.array([1.0, 0.0]))
        with pytest.raises(PredictionError, match=r"run\.csv: the motion has no bounds; where only its steps are too long"):
            m.plant().predict(run)

    def test_irregular_samples_in_a_band(self) -> None:
        time = np.array([0.0, 0.1, 0.3, 0.4])
        with pytest.raises(PredictionError, match=r"run\.csv: samples are not equally far apart; valid: between"):
            lag("band", 2).predict(run_of(time, np.zeros((4, 1))))

    def test_a_run_that_is_mostly_a_gap(self) -> None:
        time = np.array([0.0, 0.1, 0.2, 0.3, 1e6])
        with pytest.raises(PredictionError, match=r"run\.csv: samples are 0\.1 to 1e\+06 s apart; valid: a run of its own for each part"):
            lag().predict(run_of(time, np.zeros((5, 1))))

    def test_parameters(self) -> None:
        with pytest.raises(InputError, match="unknown parameter 'spirng'"):
            machine().free(["spirng"])
        with pytest.raises(InputError, match=r"parameter mass = 9 is outside its range; valid: 1\.2 … 1\.8"):
            machine().with_values({"mass": 9.0}).free(["mass"])

    @pytest.mark.parametrize(
        ("wrong", "says"),
        [
            (lambda m: m.state("v"), "m: state 'v' has no rate; valid: m.rate(v, …) for each state"),
            (lambda m: m.state("q"), "m: 'q' is there twice; valid: a name of its own for each"),
            (lambda m: m.input("y", size=1.0), "m: 'y' is there twice"),
            (lambda m: m.input("time_s", size=1.0), "m: 'time_s' is there twice"),
            (lambda m: m.output("u", 1.0), "m: 'u' is there twice"),
            (lambda m: m.parameter("k", 1.0), "m: 'k' is there twice"),
            (lambda m: m.rate(ca.SX.sym("w"), 1.0), "unknown state 'w'"),
            (lambda m: m.parameter("zero", 0.0), "zero has no range (0 … 0); valid: low and high, low below high"),
            (lambda m: m.parameter("off", 3.0, low=0.0, high=1.0), "off = 3 1 is outside its range; valid: 0 … 1"),
            (lambda m: m.parameter("nan", np.nan), "nan has no range"),
            (lambda m: m.input("f", size=0.0), "m: f: signal = 0; valid: a size above 0"),
            (lambda m: m.output("f", 0.0, size=-1.0), "m: f: signal = -1; valid: a size above 0"),
            (lambda m: m.axis("a", ca.SX(0), ca.SX(0), force=1.0, speed=np.nan), "m: a: speed = nan; valid: a size above 0"),
        ],
    )
    def test_equations(self, wrong: Callable[[Equations], object], says: str) -> None:
        m = Equations("m")
        q, u = m.state("q"), m.input("u", size=1.0)
        m.rate(q, u - m.parameter("k", 1.0) * q)
        m.output("y", q)
        with pytest.raises(InputError, match=re.escape(says)):
            _ = wrong(m), m.plant()

    def test_nothing_measured(self) -> None:
        m = Equations("m")
        m.rate(m.state("q"), 0.0)
        with pytest.raises(InputError, match="m: nothing is measured"):
            m.plant()


class TestCandidates:
    def test_every_effect_on_every_part_vanishes(self) -> None:
        """Parameters of all effects at their nulls leave exactly what the machine does without the library."""
        plain = Equations("plain", laws=())
        q, v, force = plain.state("q"), plain.state("v"), plain.input("force", size=2.0)
        plain.rate(q, v)
        plain.rate(v, (force - 20.0 * q - 1.2 * v) / 1.5)
        plain.output("position", q)
        run = pushed()
        np.testing.assert_allclose(machine().predict(run).points, plain.plant().predict(run).points, atol=1e-13)

    def test_are_there_once_for_each_part(self) -> None:
        plant = machine()
        axis = (*AXIS, *(law for law in MECHANISM if law.part == "axis"))
        expected = {f"{law.name}[{part}]" for laws, part in ((INPUT, "force"), (axis, "guide"), (OUTPUT, "position")) for law in laws}
        assert {candidate.label for candidate in plant.candidates} == expected
        for candidate in plant.candidates:
            assert candidate.probes, candidate
            for name in candidate.parameters:
                assert plant.values[name] == candidate.null[name]
                assert name not in plant.known
        assert plant.known == ("mass", "spring")

    def test_every_probe_is_allowed_and_shows(self) -> None:
        plant, run = machine(), pushed()
        quiet = plant.predict(run).points
        for candidate in plant.candidates:
            for probe in candidate.probes:
                assert set(probe) == set(candidate.parameters)
                tried = plant.with_values(probe)
                tried.free(candidate.parameters)
                shown = float(np.abs(tried.predict(run).points - quiet).max())
                assert shown > 0 or candidate.name in ("sensor_lag", "input_lag", "unequal_lag", "sensor_saturation"), (candidate, probe)

    def test_units_are_those_of_the_machine(self) -> None:
        units = {name: free.unit for name, free in machine().parameters.items()}
        assert units["input_offset[force].offset"] == "N"
        assert units["input_lag[force].time"] == "s"
        assert units["input_gain[force].loss"] == "1"
        assert units["sensor_offset[position].offset"] == "m"
        assert units["hysteresis[guide].stiffness"] == "N/m"
        assert units["hysteresis[guide].closing"] == "1/m"
        assert units["stribeck_friction[guide].speed"] == "m/s"
        m = Equations("m")
        q, v = m.state("q"), m.state("v")
        m.axis("joint", q, v, force=1.0, speed=1.0, unit="rad")
        m.axis("other", q, v, force=1.0, speed=1.0, unit="")
        m.rate(q, v)
        m.rate(v, 0.0)
        m.output("q", q)
        units = {name: free.unit for name, free in m.plant().parameters.items()}
        assert units["dry_friction[joint].force"] == "N m"
        assert units["hysteresis[joint].closing"] == "1/rad"
        assert units["dry_friction[other].force"] == units["hysteresis[other].closing"] == ""

    def test_what_people_go_on_with(self) -> None:
        plant = machine().with_values({"dry_friction[guide].force": 0.3})
        kept = [candidate for candidate in plant.candidates if candidate.name == "dry_friction"]
        assert plant.corrected_model(kept) == {"mass": 1.5, "spring": 20.0, "dry_friction[guide].force": 0.3}
        assert repr(plant) == f"CasadiPlant(a mass on a spring, {len(plant.motion.states)} states, {len(plant.candidates)} effects)"

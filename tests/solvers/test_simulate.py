"""Motion over time: reference runs, physics that must hold, sensitivities, what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.data.datasets import read_dataset
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.models.compile import compile_model
from tepm_opt.models.model import Model
from tepm_opt.outcome import Ending
from tepm_opt.solvers.mechanics import simulate as module
from tepm_opt.solvers.mechanics.simulate import Directions, SimulationError, simulate
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.solvers.mechanics.step_limit import stable_step
from tests.models.test_time_stepping import gentle
from tests.paths import reference
from tests.tools import in_company, slope

NOMINAL = Model.from_robot("kang2017")


def setpoints(time, inputs=None, force=None):
    """Set points with zeros for what is left out."""
    rows = len(time)
    return SetPoints(
        np.asarray(time, dtype=float), np.zeros((rows, 12)) if inputs is None else inputs, np.zeros((rows, 3)) if force is None else force
    )


def released(duration, rate, size):
    """The tip held aside by a force along x that lets go within 1 ms."""
    time = np.concatenate([[0, 0.001], np.arange(1, duration * rate + 1) / rate])
    force = np.zeros((len(time), 3))
    force[0, 0] = size
    return setpoints(time, force=force)


def side_force(kang, distance):
    """Force along x that holds the tip aside by a distance."""
    tip = solve_statics(kang, np.zeros(12), [1e-3, 0, 0]).tip - solve_statics(kang, np.zeros(12)).tip
    return distance / tip[0] * 1e-3


class TestReferenceRuns:
    def errors(self, kang, **settings):
        dataset = read_dataset(reference("null"))
        total, count = 0.0, 0
        for run in dataset.runs:
            found = simulate(kang, SetPoints(run.time, run.inputs, run.tip_force), **settings)
            total, count = total + ((found.points - run.points) ** 2).sum(), count + run.points.size
        assert len(dataset.runs) == 7
        return np.sqrt(total / count)

    @pytest.mark.slow
    def test_implicit(self, kang):
        assert self.errors(kang, step=0.005) < 1e-6
        assert self.errors(kang, step=0.01) < 5e-6
        assert self.errors(kang) < 5e-6
        assert self.errors(kang, error=1e-5) < 5e-7

    @pytest.mark.slow
    def test_rk4(self, kang):
        assert self.errors(kang, method="rk4") < 1e-7


@pytest.mark.parametrize("settings", [{"error": 1e-5}, {"step": 0.01}, {"step": 0.02}, {"method": "rk4"}])
def test_sway_of_the_free_arm(kang, settings):
    """Frequency and damping of a small free decay against the slowest eigenvalue, -0.245 + 5.642j 1/s (SPEC section 2)."""
    decay = simulate(kang, released(8.0, 200, side_force(kang, 1e-3)), **settings)
    time, x = decay.setpoints.time[2:], decay.tip[2:, 0] - solve_statics(kang, np.zeros(12)).tip[0]
    peaks = [k for k in range(1, len(x) - 1) if x[k] > x[k - 1] and x[k] >= x[k + 1] and time[k] > 0.5]
    tops = []
    for k in peaks:  # parabola through three samples
        second, first = x[k + 1] - 2 * x[k] + x[k - 1], (x[k + 1] - x[k - 1]) / 2
        tops.append((time[k] - first / second * 0.005, x[k] - first**2 / (2 * second)))
    (t_0, x_0), (t_1, x_1) = tops[0], tops[-1]
    assert 2 * np.pi * (len(tops) - 1) / (t_1 - t_0) == pytest.approx(5.642, rel=0.005)
    assert np.log(x_0 / x_1) / (t_1 - t_0) == pytest.approx(0.245, rel=0.03)


def energies(model, motion, force=0.0):
    """Kinetic and potential energy at every sample in J, tip forces not counted."""
    P = model.reference.prepare(np.zeros(12), True, np.zeros(12), model.theta)[1]
    mass = P[:, -1]
    kinetic = [(mass[:, None] * v[1:] ** 2).sum() / 2 for v in motion.velocities]
    return np.array(kinetic) + [model.reference.energy(x, P, model.theta) for x in motion.levels]


@pytest.mark.slow
def test_energy_of_undamped_motion_stays(kang):
    names = kang.network.parameter_names
    undamped = kang.with_theta(np.where([name == "c_a" for name in names], 0.0, kang.theta))
    motion = simulate(undamped, released(10.0, 20, side_force(kang, 0.01)), "rk4", step=1e-4)
    energy = energies(undamped, motion)[2:]
    rest = solve_statics(kang, np.zeros(12))
    P = undamped.reference.prepare(np.zeros(12), True, np.zeros(12), undamped.theta)[1]
    excess = energy[0] - undamped.reference.energy(rest.x, P, undamped.theta)
    assert excess > 1e-6
    assert abs(energy - energy[0]).max() < 1e-4 * excess


@pytest.mark.parametrize("settings", [{"step": 0.005}, {}, {"step": 0.02}, {"method": "rk4"}])
def test_damping_never_adds_energy(kang, settings):
    energy = energies(kang, simulate(kang, released(4.0, 50, side_force(kang, 0.05)), **settings))[2:]
    assert np.diff(energy).max() < 1e-9 * (energy[0] - energy[-1])


@pytest.mark.slow
@pytest.mark.parametrize("settings", [{}, {"method": "rk4"}])
def test_friction_and_creep_dissipate_over_a_closed_cycle(kang, settings):
    """The work of a slow cyclic tip force, beyond what the viscous damping takes."""
    time = np.linspace(0, 20, 401)
    force = np.column_stack([0.05 * np.sin(2 * np.pi * time / 10), 0 * time, 0 * time])
    works = {}
    for name, parameters in {"none": {}, "structural_friction": {"force": 0.1}, "creep": {"share": 0.2, "relaxation_time": 1.0}}.items():
        model = kang if name == "none" else compile_model(in_company(**{name: parameters}))
        tip = simulate(model, setpoints(time, force=force), **settings).tip[200:, 0]
        here = force[200:, 0]
        works[name] = ((here[1:] + here[:-1]) / 2 * np.diff(tip)).sum()
    assert works["none"] > 0
    assert works["structural_friction"] > 1.5 * works["none"]
    assert works["creep"] > 1.2 * works["none"]


@pytest.mark.slow
def test_pressure_hysteresis_dissipates_over_a_closed_cycle(kang):
    """Air pushed in minus air pushed out: the loop of pressure against length encloses work, whatever the rate."""
    model = compile_model(in_company(pressure_hysteresis={"width": 1e4, "distance": 1e4}))
    works = []
    for period in (20.0, 40.0):
        time = np.linspace(0, 2 * period, 401)
        inputs = np.zeros((401, 12))
        inputs[:, :6] = 1e5 * (1 - np.cos(2 * np.pi * time / period))[:, None]
        motion = simulate(model, setpoints(time, inputs))
        pressure, stretch = inputs[200:, 0], motion.lengths[200:, 0]
        works.append(50.27e-6 * ((pressure[1:] + pressure[:-1]) / 2 * np.diff(stretch)).sum())
    travel = np.ptp(stretch)
    assert works[0] == pytest.approx(2 * 1e4 * 50.27e-6 * travel, rel=0.25)  # force width times travel, less the rounded corners
    assert works[1] == pytest.approx(works[0], rel=0.02)


@pytest.mark.slow
def test_a_delay_shifts_the_motion(kang):
    plain = gentle(kang, 0.6, 31)
    plain = SetPoints(plain.time, plain.inputs, 0 * plain.tip_force)
    late = compile_model(in_company(time_delay={"delay": 0.04}))
    for settings, close in (({"step": 0.01}, 2e-8), ({}, 1e-4)):
        found, expected = simulate(late, plain, **settings), simulate(kang, plain, **settings)
        np.testing.assert_allclose(found.points[2:], expected.points[:-2], rtol=0, atol=close)


@pytest.mark.slow
def test_a_lag_follows_its_time_constants():
    """Pressure in the muscle after a jump, against exponentials: full when held, filling and exhausting differ."""
    model = compile_model(in_company(regulator_lag={"filling_time": 0.1, "exhausting_time": 0.3}))
    time = np.linspace(0, 0.4, 41)
    for start, end, constant in ((0.0, 1e5, 0.1), (1e5, 0.0, 0.3)):
        inputs = np.zeros((41, 12))
        inputs[:, 0] = np.where(time > 0.0995, end, start)  # row 10 is the first after the jump
        held = simulate(model, setpoints(time, inputs), hold=True, step=0.002)
        fine = np.linspace(0, 0.4, 401)
        effective = np.zeros((401, 12))
        effective[:, 0] = np.where(fine < time[10], start, end + (start - end) * np.exp(-(fine - time[10]) / constant))
        expected = simulate(compile_model(NOMINAL), setpoints(fine, effective))
        assert np.ptp(held.points, axis=0).max() > 0.03
        assert abs(held.points - expected.points[::10]).max() < 1e-5


@pytest.mark.slow
def test_creep_is_a_stiffness_that_fades(kang):
    """Right after a jump of load the muscles are stiffer by the share; long after they are as without creep."""
    model = compile_model(in_company(creep={"share": 0.5, "relaxation_time": 20.0}))
    time = np.array([0, 0.01, 2.0, 600.0])
    inputs = np.zeros((4, 12))
    inputs[1:, :6] = 1e5
    stretch = simulate(model, setpoints(time, inputs)).lengths.mean(axis=1)
    plain = simulate(kang, setpoints(time, inputs)).lengths.mean(axis=1)
    assert 0.6 < (stretch[2] - stretch[0]) / (plain[2] - plain[0]) < 0.9
    assert stretch[3] == pytest.approx(plain[3], abs=1e-6)


def test_held_rows_are_jumps(kang):
    """A held step is the limit of ever steeper ramps."""
    time = np.linspace(0, 0.5, 26)
    inputs = np.zeros((26, 12))
    inputs[5:, 0] = 1e5
    held = simulate(kang, setpoints(time, inputs), hold=True, step=0.002)
    steep = np.sort(np.append(time, time[5] - 1e-7))
    ramp = simulate(kang, setpoints(steep, np.insert(inputs, 5, 0, axis=0)), step=0.002)
    assert abs(held.points[6:] - ramp.points[7:]).max() < 1e-7
    assert abs(held.points - simulate(kang, setpoints(time, inputs)).points).max() > 1e-3


def test_a_violent_jump_takes_shorter_steps(kang):
    """From rest to full pressure of one side at once: the answer is that of short steps, those adapted are longer afterwards."""
    time = np.linspace(0, 0.6, 31)
    inputs = np.zeros((31, 12))
    inputs[1:, [0, 3]] = 5e5
    fine = simulate(kang, setpoints(time, inputs), step=0.001)
    for error in (2e-3, 1e-4):
        found = simulate(kang, setpoints(time, inputs), error=error)
        assert np.linalg.norm(found.points - fine.points, axis=2).max() < found.error < 2 * error
    coarse = simulate(kang, setpoints(time, inputs), step=0.01)
    assert coarse.effort.halvings > 0
    assert abs(coarse.points - fine.points).max() < 1e-3


def differences(model, points, directions, k):
    """Richardson differences of the simulated points along a direction, with a step that moves them by about 0.1 mm."""
    exact = simulate(model, points, step=0.01, directions=directions, tolerance=1e-11).sensitivities[k]
    step = min(1e-4 / abs(exact).max(), 0.05 * abs(model.theta[k]) if k < len(model.theta) and model.theta[k] else np.inf)

    def moved(change):
        theta = model.theta + change * directions.parameters[k]
        inputs = points.inputs + (0 if directions.inputs is None else change * directions.inputs[k])
        shifted = SetPoints(points.time, inputs, points.tip_force)
        return simulate(model.with_theta(theta), shifted, step=0.01, tolerance=1e-11).points

    return exact, slope(moved, step)


@pytest.mark.slow
def test_sensitivities_of_robot_and_inputs(kang):
    points = gentle(kang, 0.4, 21)
    points = SetPoints(points.time, points.inputs + 0.05 * kang.input_max, points.tip_force)
    half = kang.layout.actuator_names
    inputs = [f"pressure_{name}" for name in half] + [f"tension_{name}" for name in half]
    directions = Directions.from_names(kang, kang.network.parameter_names, inputs)
    for k, name in enumerate(directions.names):
        found, expected = differences(kang, points, directions, k)
        assert abs(found - expected).max() <= 1e-5 * abs(expected).max() + 1e-13, name


def test_sensitivities_along_one_row_of_the_inputs(kang):
    """A single sample's pressure: what optimal control needs."""
    points = gentle(kang, 0.4, 21)
    change = np.zeros((21, 1, 12))
    change[7, 0, 4] = 1.0
    directions = Directions(("row 7",), np.zeros((1, len(kang.theta))), change)
    found = simulate(kang, points, step=0.01, directions=directions, tolerance=1e-11).sensitivities[0]

    def moved(h):
        return simulate(kang, SetPoints(points.time, points.inputs + h * change[:, 0], points.tip_force), step=0.01, tolerance=1e-11).points

    np.testing.assert_allclose(found, slope(moved, 1e3), rtol=0, atol=1e-5 * abs(found).max())
    assert not found[:6].any()  # before the sample's neighbour nothing moves


class TestRk4:
    def test_its_step_limit_is_the_eigenvalue_s(self, kang):
        assert stable_step(solve_statics(kang, np.zeros(12))) == pytest.approx(0.4141e-3, rel=1e-3)

    def test_longer_steps_are_refused(self, kang):
        with pytest.raises(InputError, match=r"step: 0\.5 ms; valid with 'rk4': at most 0\.4\d+ ms, or the method 'implicit'"):
            simulate(kang, gentle(kang, 0.2, 5), "rk4", step=5e-4)

    @pytest.mark.slow
    def test_it_is_computed_once_for_a_model_and_its_rows(self, monkeypatch):
        """Other rows, other parameters and other effects have limits of their own."""
        model, computed = compile_model(NOMINAL), []
        monkeypatch.setattr(module, "stable_step", lambda found: computed.append(found) or stable_step(found))
        points = gentle(model, 0.02, 3, 0.02)
        first = simulate(model, points, "rk4")
        known = len(computed)
        assert simulate(model, points, "rk4").step == first.step
        assert len(computed) == known
        half = SetPoints(points.time, 0.5 * points.inputs, points.tip_force)
        assert simulate(model, half, "rk4").step != first.step
        assert len(computed) > known
        lighter = model.with_theta(np.where([name == "m_d" for name in model.network.parameter_names], 0.8, 1.0) * model.theta)
        assert simulate(lighter, points, "rk4").step < 0.95 * first.step
        assert simulate(model, points, "rk4").step == first.step

    @pytest.mark.slow
    def test_friction_lowers_it(self, kang):
        sticky = compile_model(in_company(structural_friction={"force": 5.0, "distance": 1e-5}))
        assert stable_step(solve_statics(sticky, np.zeros(12))) < 0.9 * stable_step(solve_statics(kang, np.zeros(12)))


class TestWrongUse:
    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"method": "euler"}, "unknown method 'euler'"),
            ({"step": 0.0}, "step: 0 s; valid: above 0"),
            ({"step": np.nan}, "step: nan s; valid: above 0"),
            ({"error": 0.0}, "error: 0 m; valid: 1e-07 … 0.1 m"),
            ({"error": np.inf}, "error: inf m; valid: 1e-07 … 0.1 m"),
            ({"error": 1e-3, "step": 0.01}, "error: steps adapt to it with method 'implicit' and without a step"),
            ({"error": 1e-3, "method": "rk4"}, "error: steps adapt to it with method 'implicit' and without a step"),
            ({"loads": np.zeros((2, 3))}, r"loads: shape \(2, 3\)"),
            ({"loads": np.full((21, 4, 3), np.nan)}, "loads: a force is not finite"),
        ],
    )
    def test_arguments(self, kang, change, message):
        with pytest.raises(InputError, match=message):
            simulate(kang, gentle(kang), **change)

    def test_set_points(self, kang):
        good = gentle(kang)
        with pytest.raises(InputError, match="1 rows; valid: at least 2"):
            simulate(kang, SetPoints(good.time[:1], good.inputs[:1], good.tip_force[:1]))
        with pytest.raises(InputError, match="time does not increase after row 3"):
            simulate(kang, SetPoints(np.r_[0, 1, 2, 2, good.time[4:] + 9], good.inputs, good.tip_force))
        with pytest.raises(InputError, match=r"row 21: pressure_\d\d = 1e\+06 Pa; valid: 0 … 500000 Pa"):
            simulate(kang, SetPoints(good.time, np.where(np.arange(21)[:, None] < 20, good.inputs, 1e6), good.tip_force))
        with pytest.raises(InputError, match="row 1: no stable equilibrium to start from"):
            simulate(kang, SetPoints(good.time, good.inputs, good.tip_force + np.array([0, 0, -3])))

    def test_directions(self, kang):
        with pytest.raises(InputError, match="unknown parameter 'K_b'"):
            Directions.from_names(kang, ["K_b"])
        with pytest.raises(InputError, match="unknown input 'pressure_99'"):
            Directions.from_names(kang, [], ["pressure_99"])
        with pytest.raises(InputError, match="sensitivities are computed by method 'implicit'"):
            simulate(kang, gentle(kang), "rk4", directions=Directions.from_names(kang, ["K_a"]))


def test_an_interrupted_simulation_keeps_what_it_has(kang):
    points = gentle(kang, 3.0, 31)

    def interrupt(_, done, of):
        if done > of / 2:
            raise KeyboardInterrupt

    partial = simulate(kang, points, progress=interrupt)
    assert partial.outcome.ending is Ending.INTERRUPTED
    with pytest.raises(KeyboardInterrupt):
        partial.complete()
    assert 15 <= len(partial.points) <= 25
    np.testing.assert_array_equal(partial.points, simulate(kang, points).points[: len(partial.points)])


def test_a_failure_says_when(kang, monkeypatch):
    """An RK4 step beyond stability, let through: the motion is stopped when it leaves all bounds."""
    monkeypatch.setattr(module, "_stable_step", lambda *_: 6e-4)
    failed = simulate(kang, gentle(kang, 1.0, 51), "rk4")
    assert failed.outcome.ending is Ending.FAILED
    assert 0 < len(failed.points) < 51
    assert np.isfinite(failed.points).all()
    with pytest.raises(SimulationError, match=r"left all bounds after 0\.\d+ s \(a shorter step may help; step 0\.0006 s\)"):
        failed.complete()


def test_two_runs_are_the_same_bytes(kang):
    points = gentle(kang, 0.3, 16)
    assert simulate(kang, points).levels.tobytes() == simulate(kang, points).levels.tobytes()


def test_time_need_not_be_even(kang):
    """Samples at odd times are hit exactly."""
    points = gentle(kang, 0.4, 21)
    keep = [0, 1, 2, 5, 6, 11, 20]
    odd = SetPoints(points.time[keep], points.inputs[keep], points.tip_force[keep])
    dense = SetPoints(points.time, np.stack([np.interp(points.time, odd.time, c) for c in odd.inputs.T], 1),
                      np.stack([np.interp(points.time, odd.time, c) for c in odd.tip_force.T], 1))  # fmt: skip
    assert abs(simulate(kang, odd, step=0.002).points - simulate(kang, dense, step=0.002).points[keep]).max() < 1e-7

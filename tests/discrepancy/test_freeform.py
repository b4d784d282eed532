"""Laws that nobody wrote down: what they would change to first order, and where what is left says that they act."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tepm_opt.data.run import Run, thin_out
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.discrepancy.symbolic import score
from tepm_opt.discrepancy.symbolic.curves import Lags, Plays, Powers, Spline
from tepm_opt.discrepancy.symbolic.places import ALL, Course, Place, find_places
from tepm_opt.discrepancy.symbolic.responses import Normal, point_responses, simulate_courses
from tepm_opt.discrepancy.symbolic.score import Scored, alternatives
from tepm_opt.discrepancy.symbolic.settings import DEFAULT
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.identification.identify import ParameterEstimate, Problem, identify
from tepm_opt.solvers.mechanics.network_plant import NetworkPlant, free_parameters
from tepm_opt.solvers.mechanics.simulate import simulate
from tests.discrepancy.small import NOISE, changed, cut, measured, planned, true_values

FILES = ("single_pressure.csv", "single_tension.csv", "elongation.csv")


@pytest.fixture(scope="module")
def course(kang: CompiledModel) -> Course:
    asked = planned(("single_pressure.csv",))[0]
    run = cut(measured(kang, [asked])[0], 4.0)
    run = replace(run, inputs=run.inputs + 1e3 * (np.arange(12) < 6))  # off the limit of the pressures
    return simulate_courses(NetworkPlant(kang), [run])[0]


def under(model: CompiledModel, course: Course, inputs: np.ndarray, loads: np.ndarray) -> np.ndarray:
    """Points under changed inputs and forces."""
    run = course.run
    asked = SetPoints(run.time, run.inputs + inputs, run.tip_force)
    return simulate(model, asked, step=DEFAULT.sample_spacing, loads=loads, tolerance=1e-11).complete().points


@pytest.mark.parametrize("number", range(6))
def test_responses_are_differences_of_simulations(kang: CompiledModel, course: Course, number: int) -> None:
    """The law acts in a simulation of its own, at a small size, along a random combination of its coefficients."""
    length = Spline.from_values(course.lengths.ravel(), 3)
    place = (
        Place("axial", "13", "pressure", Spline((0.0, 1e5, 2e5))),
        Place("axial", ALL, "length", length),
        Place("axial", ALL, "length", length, times="pressure", most=1e5),
        Place("axial", "11", "pressure", Plays((1e3, 1e4), 1e5), "remembered"),
        Place("force", "s4", "position", Spline.from_values(course.points[:, -1].ravel(), 2)),
        Place("force", "s2", "speed", Powers((), (), 0)),
    )[number]
    by = point_responses(course, [place], [])[1][0]
    weights, small = np.random.default_rng(number).normal(size=place.size), 1e-4
    law = np.moveaxis(place.columns(course), 1, -1) @ weights
    inputs, loads = np.zeros_like(course.run.inputs), np.zeros((course.run.rows, 4, 3))
    if place.kind == "axial":
        inputs[:, :6] = small * law / kang.values["A"]
    else:
        loads = small * law
    moves = [under(kang, course, sign * inputs, sign * loads) for sign in (1, -1)]
    expected = (moves[0] - moves[1]) / (2 * small)
    found = np.moveaxis(by, 1, -1) @ weights
    assert np.abs(found - expected).max() <= 1e-3 * np.abs(expected).max()


def test_what_acts_on_all_alike_is_the_sum(kang: CompiledModel, course: Course) -> None:
    shape = Spline((0.0, 1e5, 2e5))
    each = [Place("axial", name, "pressure", shape) for name in kang.layout.actuator_names]
    together = Place("axial", ALL, "pressure", shape)
    summed = point_responses(course, [together, *each], [])[1][0]
    alone = point_responses(course, [together], [])[1][0]
    assert np.abs(summed - alone).max() <= 1e-9 * np.abs(alone).max()


class TestShapes:
    def test_a_spline_is_any_parabola_and_goes_on_straight(self) -> None:
        shape, values = Spline((0.0, 1.0, 3.0)), np.linspace(0, 3, 50)
        columns = shape.columns(values, values)
        for truth in (np.ones(50), values, values**2):
            left = truth - columns @ np.linalg.lstsq(columns, truth, rcond=None)[0]
            assert np.abs(left).max() < 1e-12
        beyond = shape.columns(np.array([3.0, 4.0, 5.0]), values)
        np.testing.assert_allclose(beyond[2] - beyond[1], beyond[1] - beyond[0], atol=1e-12)

    def test_lags_of_a_ramp(self) -> None:
        time = np.linspace(0, 10, 101)
        (behind,) = Lags((0.5,), 2.0).columns(3 * time, time).T
        assert behind[-1] == pytest.approx(-3 * 0.5 / 2.0)
        assert behind[0] == 0

    def test_a_play_forgets_small_turns(self) -> None:
        values = np.array([0.0, 1.0, 0.8, 1.0, 0.0])
        np.testing.assert_allclose(Plays((0.2,), 1.0).output(values, values, 0.2), [0.0, 0.8, 0.8, 0.8, 0.2])

    def test_powers_count(self) -> None:
        assert Powers.from_values(np.random.default_rng(0).normal(size=(9, 3)), 2).size == 10


def fitted(kang: CompiledModel, runs: list[Run]) -> ParameterEstimate:
    free = free_parameters(kang, tuple(kang.robot.priors))
    return identify(Problem(NetworkPlant(kang), tuple(runs), free, NOISE, step=0.02, derivatives_apart=0.04))


@pytest.fixture(scope="module")
def true(kang: CompiledModel) -> CompiledModel:
    return changed(kang, **true_values(kang))


def best(found: list[Scored]) -> Scored:
    return found[0]


class TestAlternatives:
    """Data of the package's own simulation with the robot's parameters off, and a law that no effect of the model has."""

    @pytest.mark.slow
    def test_the_muscle_and_its_variable_are_found(self, kang: CompiledModel, true: CompiledModel) -> None:
        asked = planned(FILES)
        bent = []
        for each in asked:
            inputs = each.setpoints.inputs.copy()
            inputs[:, 4] -= inputs[:, 4] ** 2 / 2e6
            bent.append(replace(each, setpoints=replace(each.setpoints, inputs=inputs)))
        runs = [replace(run, inputs=each.setpoints.inputs) for run, each in zip(measured(true, bent), asked, strict=True)]
        found = best(alternatives(fitted(kang, runs)))
        assert found.place.label == "axial[22](pressure)"
        assert found.closes > 0.98
        pressures = np.linspace(0, 3e5, 30)
        shape = found.place.shape.columns(pressures, pressures)
        law, truth = shape @ found.coefficients, -kang.values["A"] * pressures**2 / 2e6
        assert np.sqrt(np.mean((law - truth) ** 2)) < 0.1 * np.sqrt(np.mean(truth**2))

    @pytest.mark.slow
    def test_a_tracker_that_drifts_is_told_from_forces(self, kang: CompiledModel, true: CompiledModel) -> None:
        runs, began = [], 0.0
        for run in measured(true, planned(FILES)):
            drift = 4e-5 * (began + run.time)[:, None, None] * np.array([1.0, -0.5, 0.2])
            runs.append(replace(run, points=run.points + drift, began=began))
            began += 5.0 + float(run.time[-1])
        assert best(alternatives(fitted(kang, runs))).place.label == "measurement[all](time)"

    @pytest.mark.slow
    def test_noise_alone_closes_nothing(self, kang: CompiledModel, true: CompiledModel) -> None:
        found = alternatives(fitted(kang, measured(true, planned(FILES))))
        assert max(each.closes for each in found) < 0.25

    def test_places_are_those_of_the_robot(self, kang: CompiledModel, course: Course) -> None:
        labels = [place.label for place in find_places([course])]
        assert len(labels) == len(set(labels))
        assert "axial[23](pressure)" in labels
        assert "measurement[s3](position)" in labels
        assert not any("(tension)" in label for label in labels)  # which this run never changes

    def test_few_runs_are_left_out_in_parts(self) -> None:
        ones = score.Normal(np.ones((9, 1, 1)), np.ones((9, 1)), np.ones(9), np.ones(9, dtype=int))
        assert len(score._folds([ones, ones])) == 8
        assert len(score._folds([ones] * 3)) == 3


def test_samples_of_the_pass_are_the_runs(course: Course) -> None:
    assert thin_out(course.run, DEFAULT.sample_spacing).rows == course.run.rows


def test_a_law_is_judged_by_the_predictive_distribution_of_the_other_runs() -> None:
    """By its definition: noise, and what the others and the prior leave open of two parameters and two coefficients."""
    random, runs = np.random.default_rng(0), []
    for k in range(4):
        by = random.normal(size=(5, 30, 4)) * (1, 1, 1, 1 if k == 0 else 0.05)  # the last is hardly told by other runs than the first
        left = 3 * random.normal(size=(5, 30)) + by @ (0.1, 0.2, 0, 0.3)
        slope = np.einsum("bri,br->bi", by, left)
        runs.append(Normal(np.einsum("bri,brj->bij", by, by), slope, np.sum(left**2, axis=1), np.full(5, 30)))
    precision, pull, extra = np.array([1.0, 2.0]), np.array([0.3, 0.1]), np.diag([0.5, 0.7])
    errors, steps = score.left_out_errors(runs, precision, pull, extra)
    square, slope = (np.sum([getattr(run, name).sum(axis=0) for run in runs], axis=0) for name in ("square", "slope"))
    known, pulled = np.diag([*precision, *np.diag(extra)]), slope + np.append(pull, [0.0, 0.0])
    found = score._predictive(runs, errors, steps, pulled, -np.linalg.solve(square + known, pulled))
    for k, run in enumerate(runs):
        own, turned = run.square.sum(axis=0), run.slope.sum(axis=0)
        others = square - own + known
        at = -np.linalg.solve(others, pulled - turned)
        against = turned + own @ at
        expected = run.squares.sum() + 2 * turned @ at + at @ own @ at - against @ np.linalg.solve(others + own, against)
        assert found[5 * k : 5 * k + 5].sum() == pytest.approx(expected, rel=1e-6)
    assert found[:5].sum() < 0.9 * errors[:5].sum(), "the values that the others give alone say something else"

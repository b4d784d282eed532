"""Predictions of runs, and parameters found from runs whose true ones are known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from tepm_opt.data.run import Run
from tepm_opt.errors import InputError
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.solvers.identification.identify import ParameterEstimate, Problem, identify
from tepm_opt.solvers.identification.residuals import normal_equations
from tepm_opt.solvers.identification.uncertainty import multi_start, profile, unidentifiable
from tepm_opt.solvers.mechanics.network_plant import NetworkPlant, free_parameters
from tepm_opt.solvers.mechanics.plant import Free, Prediction, PredictionError
from tepm_opt.solvers.mechanics.predict import predict, predict_all
from tepm_opt.solvers.mechanics.simulate import simulate
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.solvers.numerics.least_squares import bounded_step
from tests.discrepancy.small import FILES, NOISE, STEP, changed, measured, planned, true_values
from tests.tools import in_company, random_inputs, relative, slope, stages_into

EIGHT = {"K_a": 1.02, "c_a": 0.85, "alpha_1": 1.1, "alpha_2": 1.04, "beta_1": 1.2, "beta_2": 0.9, "r": 1.01, "m_d": 0.985}
"""True parameters over the robot file's."""
DEVIATIONS = 2.8  # of several parameters together, one beyond it in some 30 draws of the noise


@pytest.fixture(scope="module")
def runs(kang: CompiledModel) -> tuple[Run, ...]:
    """Runs of a machine whose four parameters with priors differ from the robot file's."""
    return tuple(measured(changed(kang, **true_values(kang)), planned(FILES[:3])))


@pytest.fixture(scope="module")
def estimate(kang: CompiledModel, runs: tuple[Run, ...]) -> ParameterEstimate:
    return identify(problem(kang, runs))


def problem(model: CompiledModel, runs: tuple[Run, ...], *names: str, static: bool = False, **settings: bool) -> Problem:
    """Parameters by name, or those with priors, to be found with steps as short as the runs were made with."""
    return Problem(NetworkPlant(model, static), runs, free_parameters(model, names or None), NOISE, step=STEP, **settings)


def misses(estimate: ParameterEstimate, truth: dict[str, float], std: np.ndarray | None = None) -> dict[str, float]:
    """Errors over their standard deviations."""
    std = estimate.std if std is None else std
    return {name: (value - truth[name]) / sigma for (name, value), sigma in zip(estimate.named.items(), std, strict=True)}


def largest(misses: dict[str, float]) -> float:
    return max(abs(miss) for miss in misses.values())


def steady(kang: CompiledModel, inputs: np.ndarray, truth: dict[str, float], noise: float = NOISE) -> Run:
    """Equilibria of a machine under rows of inputs, with a known tip force in every other row."""
    machine, random = changed(kang, **truth), np.random.default_rng(5)
    force = np.where(np.arange(len(inputs))[:, None] % 2, [0.1, -0.05, 0.1], 0.0)
    points = np.array([solve_statics(machine, u, f).points for u, f in zip(inputs, force, strict=True)])
    return Run("steady.csv", "fit", np.full(len(inputs), np.nan), inputs, force, points + noise * random.normal(size=points.shape))


class TestPredictions:
    def test_are_what_simulate_says(self, kang: CompiledModel) -> None:
        (run,) = measured(kang, planned(FILES[2:3]), noise=0.0)
        assert np.abs(predict(kang, run, step=STEP).points - run.points).max() < 1e-12
        assert np.sqrt(np.mean((predict(kang, run).points - run.points) ** 2)) < 0.5 * NOISE, "the default step is too long"

    def test_of_several_runs_keep_their_order(self, kang: CompiledModel, runs: tuple[Run, ...]) -> None:
        for run, found in zip(runs, predict_all(kang, runs, ["K_a"]), strict=True):
            alone = predict(kang, run, ["K_a"])
            np.testing.assert_array_equal(found.points, alone.points)
            np.testing.assert_array_equal(found.by, alone.by)

    @pytest.mark.slow
    def test_sensitivities_of_a_motion(self) -> None:
        model = compile_model(in_company(payload={"mass": 0.01}))
        run = measured(model, planned(FILES[2:3]), noise=0.0)[0]
        run = replace(run, **{name: getattr(run, name)[:120] for name in ("time", "inputs", "tip_force", "points")})
        scales = {"K_a": 1.0, "m_d": 1e-3, "alpha_2": 0.01, "c_a": 0.02, "r": 1e-4, "payload.mass": 1e-3}
        found = predict(model, run, list(scales), step=0.01)
        for name, by in zip(scales, found.by, strict=True):
            value = model.values[name]
            differences = slope(lambda d, n=name, v=value: predict(changed(model, **{n: v + d}), run, step=0.01).points, scales[name])
            assert relative(by, differences) < 2e-4, name

    def test_sensitivities_of_equilibria(self, kang: CompiledModel) -> None:
        run = steady(kang, random_inputs(kang, 4, 3, 0.0, 0.5), {})
        scales = {"K_a": 1.0, "m_d": 1e-3, "r": 1e-4, "alpha_2": 0.01}
        found = predict(kang, run, list(scales), static=True)
        for name, by in zip(scales, found.by, strict=True):
            value = kang.values[name]
            differences = slope(lambda d, n=name, v=value: predict(changed(kang, **{n: v + d}), run, static=True).points, scales[name])
            assert relative(by, differences) < 1e-4, name

    def test_derivatives_of_every_other_sample(self, kang: CompiledModel) -> None:
        """Values of every sample as before, derivatives nearly, and a gap in time or data changes nothing in that."""
        (run,) = measured(kang, planned(FILES[2:3]))
        kept = np.delete(np.arange(run.rows), np.r_[31:40, 77])
        run = replace(run, **{name: getattr(run, name)[kept] for name in ("time", "inputs", "tip_force", "points")})
        run.points[50:60, 1] = np.nan
        whole = Problem(NetworkPlant(kang), (run,), free_parameters(kang), NOISE)
        sparse = replace(whole, derivatives_apart=0.04)
        (one,), (other,) = whole.residuals(whole.start), sparse.residuals(sparse.start)
        np.testing.assert_allclose(other.values, one.values, atol=1e-4)  # up to the tolerance of the steps
        assert (other.by.reshape(*run.points.shape, -1)[50:60, 1] == 0).all()
        for free, by, found in zip(whole.free, one.by.T, other.by.T, strict=True):
            assert 0 < np.linalg.norm(found - by) / np.linalg.norm(by) < 0.2, free.name
        (few,) = sparse.sparse.runs
        assert set(few.time) < set(run.time)
        assert (few.time[0], few.time[-1]) == (run.time[0], run.time[-1])
        assert 0.45 < few.rows / run.rows < 0.6
        assert np.diff(few.time)[:-1].min() > 0.03

    def test_what_cannot_be_predicted_names_the_run(self, kang: CompiledModel, runs: tuple[Run, ...]) -> None:
        blown_up = replace(runs[0], inputs=runs[0].inputs + np.repeat([1e6, 0.0], 6))
        for static in (False, True):
            with pytest.raises((PredictionError, InputError), match=rf"{runs[0].file}: .*row 1: pressure_11 = 1e\+06 Pa; valid"):
                predict(kang, blown_up, static=static)

    def test_without_an_equilibrium(self, kang: CompiledModel, runs: tuple[Run, ...]) -> None:
        """The arm buckles under 3 N from above."""
        pushed = replace(runs[0], tip_force=runs[0].tip_force + np.array([0.0, 0.0, -3.0]))
        for static in (False, True):
            with pytest.raises(PredictionError, match=rf"{runs[0].file}: .*row 1: .*unstable"):
                predict(kang, pushed, static=static)

    def test_unknown_parameter(self, kang: CompiledModel, runs: tuple[Run, ...]) -> None:
        with pytest.raises(InputError, match=r"'K_b'.*K_a"):
            predict(kang, runs[0], ["K_b"])


class TestRecovery:
    def test_parameters_with_priors(self, kang: CompiledModel, estimate: ParameterEstimate) -> None:
        assert estimate.solved
        assert estimate.cost / estimate.count == pytest.approx(1.0, abs=0.03)
        assert set(estimate.named) == {"K_a", "m_d", "alpha_2", "c_a"}
        assert largest(missed := misses(estimate, true_values(kang))) < DEVIATIONS, missed
        assert not estimate.at_bound.any()

    @pytest.mark.slow
    def test_eight_parameters_from_motion_by_another_integrator(self, kang: CompiledModel) -> None:
        truth = {name: factor * kang.values[name] for name, factor in EIGHT.items()}
        machine, random = changed(kang, **truth), np.random.default_rng(8)
        runs = []
        for run in planned(FILES[:2], seed=3):
            asked = run.setpoints
            points = simulate(machine, asked, method="rk4").points
            points = points + NOISE * random.normal(size=points.shape)
            runs.append(Run(run.file, "fit", asked.time, asked.inputs, asked.tip_force, points))
        found = identify(replace(problem(kang, tuple(runs), *EIGHT), step=0.01))
        assert found.cost / found.count == pytest.approx(1.0, abs=0.03)
        assert largest(missed := misses(found, truth)) < DEVIATIONS, missed
        relative_std = dict(zip(found.named, found.std / np.abs(found.values), strict=True))
        assert max(relative_std[name] for name in ("K_a", "c_a", "alpha_2", "r", "m_d")) < 0.03, relative_std
        assert relative_std["beta_2"] < 0.3, relative_std
        words = unidentifiable(found)
        assert any("beta_1" in text for text in words), words
        assert not any(name in text.replace(",", " ").split() for name in ("K_a", "alpha_2", "r", "m_d") for text in words), words

    def test_equilibria(self, kang: CompiledModel) -> None:
        truth = {"K_a": 1.02 * kang.values["K_a"], "m_d": 0.985 * kang.values["m_d"], "r": 1.01 * kang.values["r"]}
        run = steady(kang, random_inputs(kang, 40, 4, 0.0, 0.4), truth)
        found = identify(problem(kang, (run,), *truth, static=True))
        assert found.cost / found.count == pytest.approx(1.0, abs=0.2)
        assert largest(missed := misses(found, truth)) < DEVIATIONS, missed
        assert max(found.std / found.values) < 0.02, found.std / found.values

    @pytest.mark.slow
    def test_an_effect_beside_the_robot(self, kang: CompiledModel) -> None:
        model = compile_model(in_company(payload={"mass": 0.0}))
        truth = {"payload.mass": 0.008, "K_a": 1.01 * kang.values["K_a"]}
        runs = tuple(measured(changed(model, **truth), planned(FILES[:2])))
        found = identify(problem(model, runs, *truth))
        assert largest(missed := misses(found, truth)) < DEVIATIONS, missed
        assert found.plant.values["payload.mass"] == found.named["payload.mass"]

    @pytest.mark.slow
    def test_missing_samples_and_a_missing_sensor(self, kang: CompiledModel, runs: tuple[Run, ...], estimate: ParameterEstimate) -> None:
        random = np.random.default_rng(2)
        holey = []
        for run in runs:
            points = run.points.copy()
            points[random.random(points.shape[:2]) < 0.3] = np.nan
            points[:, 2] = np.nan
            holey.append(replace(run, points=points))
        found = identify(problem(kang, tuple(holey)))
        assert found.count == sum(int(np.isfinite(run.points).sum()) for run in holey)
        assert largest(missed := misses(found, true_values(kang))) < DEVIATIONS, missed
        assert (found.std > 0.9 * estimate.std).all(), "fewer samples cannot tell more"

    @pytest.mark.slow
    def test_from_nearby_first_derivatives_serve(
        self, kang: CompiledModel, runs: tuple[Run, ...], estimate: ParameterEstimate, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """From two standard deviations aside, with derivatives of every other sample, to where all of them at every step lead."""
        asked: list[int] = []

        def watched(model: CompiledModel, run: Run, names: Sequence[str] = (), *others: Any) -> Prediction:
            asked.append(len(names))
            return predict(model, run, names, *others)

        monkeypatch.setattr("tepm_opt.solvers.mechanics.network_plant.predict", watched)
        aside = estimate.values + 2 * estimate.std * np.array([1, -1, 1, -1])
        free = tuple(replace(f, start=float(value)) for f, value in zip(estimate.problem.free, aside, strict=True))
        found = identify(replace(estimate.problem, free=free, derivatives_apart=0.04), near=True)
        assert found.solved
        assert found.iterations >= 1
        assert (np.abs(found.values - estimate.values) < 0.05 * estimate.std).all()
        np.testing.assert_allclose(found.std, estimate.std, rtol=0.05)
        assert sum(count > 0 for count in asked) == len(runs), "once a run"

    @pytest.mark.slow
    def test_robust_against_outliers(self, kang: CompiledModel, runs: tuple[Run, ...], estimate: ParameterEstimate) -> None:
        """3 % of the poses are of another marker, 20 mm aside and below."""
        random = np.random.default_rng(3)
        spoilt = []
        for run in runs:
            other = random.random(run.points.shape[:2]) < 0.03
            spoilt.append(replace(run, points=run.points + other[:, :, None] * np.array([12e-3, 0.0, -16e-3])))
        robust, plain = (identify(problem(kang, tuple(spoilt), robust=robust)) for robust in (True, False))
        truth = true_values(kang)
        assert largest(misses(robust, truth)) < DEVIATIONS
        off = {name: largest(misses(each, truth, estimate.std)) for name, each in (("robust", robust), ("plain", plain))}
        assert off["plain"] > 10 > off["robust"], off


class TestPriors:
    @pytest.mark.slow
    def test_bind(self, kang: CompiledModel) -> None:
        runs = tuple(measured(changed(kang, K_a=1.06 * kang.values["K_a"]), planned(FILES[:1])))
        found = identify(problem(kang, runs, "K_a"))
        assert found.named["K_a"] == pytest.approx(1.03 * kang.values["K_a"], rel=1e-9)
        assert found.at_bound.all()

    def test_are_the_robot_file_s(self, kang: CompiledModel) -> None:
        for free in free_parameters(kang):
            half = kang.robot.priors[free.name]
            nominal = kang.values[free.name]
            assert (free.low, free.start, free.high) == pytest.approx((nominal * (1 - half), nominal, nominal * (1 + half)))
            assert free.spread == pytest.approx(2 * half * nominal / np.sqrt(12))

    def test_start_outside_is_refused(self, kang: CompiledModel) -> None:
        with pytest.raises(InputError, match=r"K_a = 376.8.*outside its prior.*348.*369"):
            free_parameters(changed(kang, K_a=1.05 * kang.values["K_a"]), ["K_a"])

    def test_unknown_parameter(self, kang: CompiledModel) -> None:
        with pytest.raises(InputError, match=r"'payload.mass'"):
            free_parameters(kang, ["payload.mass"])

    def test_nothing_to_fit_to(self, kang: CompiledModel, runs: tuple[Run, ...]) -> None:
        for none in ((), tuple(replace(run, points=np.full_like(run.points, np.nan)) for run in runs)):
            with pytest.raises(InputError, match="nothing to fit to"):
                identify(problem(kang, none))


class TestWhatRunsCannotTell:
    def test_nothing_moves(self, kang: CompiledModel, runs: tuple[Run, ...]) -> None:
        """At rest without inputs nothing tells the damping, and stiffness is told from mass by their ratio at most."""
        still = replace(runs[0], inputs=np.zeros_like(runs[0].inputs), points=np.broadcast_to(runs[0].points[:1], runs[0].points.shape))
        found = identify(problem(kang, (still,)), max_iterations=0)
        words = unidentifiable(found)
        assert "c_a has hardly any influence in these runs" in words, words
        assert len(words) >= 2, words

    def test_all_is_well(self, estimate: ParameterEstimate) -> None:
        assert unidentifiable(estimate) == []
        assert len(unidentifiable(estimate, max_relative_std=0.0)) == len(estimate.values), "but nothing is known exactly"

    def test_profile_of_what_is_well_known(self, kang: CompiledModel) -> None:
        run = steady(kang, random_inputs(kang, 20, 6, 0.0, 0.4), {"K_a": 1.01 * kang.values["K_a"]})
        found = identify(problem(kang, (run,), "K_a", "r", static=True))
        (value, _), (std, _) = found.values, found.std
        assert profile(found, "K_a") == pytest.approx((value - 1.96 * std, value + 1.96 * std), abs=0.1 * std)
        assert profile(found, "K_a", threshold=1.0) == pytest.approx((value - std, value + std), abs=0.1 * std)

    def test_profile_ends_at_a_bound(self, kang: CompiledModel, runs: tuple[Run, ...]) -> None:
        """Nothing moves, so that the damping may be anything within its prior."""
        still = replace(runs[0], inputs=np.zeros_like(runs[0].inputs))
        found = identify(replace(problem(kang, (still,), "c_a"), step=0.02), max_iterations=0)
        (free,) = found.problem.free
        assert profile(found, "c_a") == (free.low, free.high)

    def test_profile_of_what_is_not_free(self, estimate: ParameterEstimate) -> None:
        with pytest.raises(InputError, match=r"'r'.*K_a"):
            profile(estimate, "r")


@pytest.mark.slow
def test_several_starts_are_repeatable(kang: CompiledModel, runs: tuple[Run, ...]) -> None:
    task = replace(problem(kang, runs[:1]), step=0.02)
    stages: list[str] = []
    first, second = (multi_start(task, 2, seed=4, progress=stages_into(stages)) for _ in range(2))
    np.testing.assert_array_equal(first.values, second.values)
    assert set(stages) == {"fit 1 of 2", "fit 2 of 2"}
    assert first.cost <= identify(task).cost


@dataclass(frozen=True)
class Column:
    """A column under an axial load, Euler's: a small side force bends it by F / (k - load), and beyond k it buckles."""

    values: Mapping[str, float]
    static: bool = True
    concurrent: bool = False
    states: Mapping[str, float] = field(default_factory=dict)

    def with_values(self, values: Mapping[str, float]) -> Column:
        return replace(self, values={**self.values, **values})

    def free(self, names: Sequence[str]) -> tuple[Free, ...]:
        return tuple(Free(name, "1", self.values[name], 0.0, 1e3, 0.1) for name in names)

    def predict(self, run: Run, by: Sequence[str] = (), step: float = np.inf) -> Prediction:
        left = self.values["stiffness"] - self.values["load"] * run.inputs
        if not left.min() > 0:
            raise PredictionError(f"{run.file}: buckles")
        slopes = {"load": run.inputs / left**2, "stiffness": -1 / left**2}
        return Prediction((1 / left)[..., None], np.array([slopes[name] for name in by]).reshape(-1, run.rows, 1, 1))


def column(load: float, noise: float = 0.01) -> Run:
    """What such a column of stiffness 1 does under parts of a load."""
    parts = np.linspace(0.1, 1.0, 10)[:, None]
    bent = (
        Column({"stiffness": 1.0, "load": load})
        .predict(Run("column", "fit", np.arange(10.0), parts, np.zeros((10, 3)), parts[..., None]))
        .points
    )
    return Run("column", "fit", np.arange(10.0), parts, np.zeros((10, 3)), bent + noise * np.random.default_rng(1).normal(size=bent.shape))


@pytest.mark.parametrize("load", [0.9, 0.99])
@pytest.mark.parametrize("names", [("load",), ("load", "stiffness")])
def test_steps_that_would_buckle_are_shortened(load: float, names: tuple[str, ...]) -> None:
    """The first one goes far beyond what the column bears."""
    plant = Column({"stiffness": 1.0, "load": 0.1})
    task = Problem(plant, (column(load),), plant.free(names), 0.01)
    square, slope_ = normal_equations(task.residuals(task.start))
    step, _ = bounded_step(square, slope_, task.low - task.start, task.high - task.start, task.scale)
    with pytest.raises(PredictionError):
        task.residuals(task.start + step)
    found = identify(task)
    assert found.solved, found.outcome
    assert largest(misses(found, {"stiffness": 1.0, "load": load})) < DEVIATIONS
    np.testing.assert_array_equal(found.values, identify(task).values)


def test_a_fit_whose_best_values_nearly_buckle_comes_close_to_them() -> None:
    """One row is bent so far that hardly any load does it that the column bears."""
    plant, run = Column({"stiffness": 1.0, "load": 0.1}), column(0.99)
    run.points[-1] = 1e4
    task = Problem(plant, (run,), plant.free(["load"]), 0.01)
    (value,) = identify(task, max_iterations=30).values
    assert 0.999 < value < 1.0


@dataclass(frozen=True)
class Filling(Column):
    """What comes to 1 after a time constant."""

    def free(self, names: Sequence[str]) -> tuple[Free, ...]:
        return tuple(Free(name, "s", self.values[name], 0.01, 1e3, 0.1) for name in names)

    def predict(self, run: Run, by: Sequence[str] = (), step: float = np.inf) -> Prediction:
        left = np.exp(-run.time / self.values["T"])[:, None, None]
        return Prediction(1 - left, (-run.time[:, None, None] / self.values["T"] ** 2 * left)[None].repeat(len(by), axis=0))


@pytest.mark.parametrize("begin", [0.2, 20.0, 200.0])
def test_a_time_constant_does_not_leap_past_its_best(begin: float) -> None:
    """From far above the first step to first order goes below 0: at the bound all is there at once, and nothing changes any more."""
    run = column(0.9)
    made = Filling({"T": 1.0}).predict(run).points
    task = Problem(Filling({"T": begin}), (replace(run, points=made),), Filling({"T": begin}).free(["T"]), 0.01)
    found = identify(task)
    assert found.solved, found.outcome
    assert found.values == pytest.approx([1.0], rel=1e-3)


@pytest.mark.parametrize("seed", range(25))
def test_bounded_steps_are_least_squares(seed: int) -> None:
    random = np.random.default_rng(seed)
    count = int(random.integers(1, 9))
    A, r = random.normal(size=(3 * count, count)), random.normal(size=3 * count)
    scale = 10 ** random.uniform(-3, 3, count)
    low, high = -random.uniform(0, 0.5, count), random.uniform(0, 0.5, count)
    low[random.random(count) < 0.2] = 0.0  # at the bound already
    high[random.random(count) < 0.2] = np.inf
    d, less = bounded_step(A.T @ A / np.outer(scale, scale), A.T @ r / scale, low * scale, high * scale, scale)
    expected = lsq_linear(A, -r, bounds=(low, np.maximum(high, low + 1e-12)), method="bvls", tol=1e-14).x
    np.testing.assert_allclose(d / scale, expected, atol=1e-7)
    assert less == pytest.approx(r @ r - np.sum((A @ expected + r) ** 2), abs=1e-6)


def test_a_direction_without_influence_stays() -> None:
    d, less = bounded_step(np.diag([4.0, 0.0]), np.array([-2.0, 0.0]), np.full(2, -10.0), np.full(2, 10.0), np.ones(2))
    assert d == pytest.approx([0.5, 0.0])
    assert less == pytest.approx(1.0)


def test_rounding_that_makes_a_square_negative_ends_no_step() -> None:
    """Information as a difference of nearly equal sums: two directions that cannot be told apart, beyond the last digits."""
    square = np.array([[1.0, 1.0 + 1e-8], [1.0 + 1e-8, 1.0]])
    d, less = bounded_step(square, np.array([-1.0, -1.0]), np.full(2, -10.0), np.full(2, 10.0), np.ones(2))
    assert d.sum() == pytest.approx(1.0, rel=1e-6)
    assert less == pytest.approx(1.0, rel=1e-6)

"""How hypotheses are judged by data that was left out of their fits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection import cross_validation as evidences
from tepm_opt.discrepancy.selection.cross_validation import Evidence, leave_out, weights
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.identification.identify import ParameterEstimate, Problem, identify
from tepm_opt.solvers.mechanics.network_plant import NetworkPlant, free_parameters
from tests.discrepancy.small import FILES, NOISE, STEP, changed, cut, measured, planned, true_values

BLOCKS, SAMPLES, SETTINGS = 40, 600, SearchSettings()


def evidence(size: float = 1.0, parameters: int = 4, seed: int = 0) -> Evidence:
    """Squared errors of `size` times the noise, alike in all blocks but for chance."""
    return made(size**2 * np.random.default_rng(seed).chisquare(SAMPLES, BLOCKS), np.full(BLOCKS, SAMPLES), parameters)


def made(squares: np.ndarray, counts: np.ndarray, parameters: int = 1) -> Evidence:
    return Evidence(squares, counts, parameters, np.zeros(parameters))


@pytest.fixture(scope="module")
def runs(kang: CompiledModel) -> list[Run]:
    return [cut(run, 4.0) for run in measured(changed(kang, **true_values(kang)), planned(FILES[:3]))]


def fitted(kang: CompiledModel, runs: list[Run]) -> ParameterEstimate:
    return identify(Problem(NetworkPlant(kang), tuple(runs), free_parameters(kang), NOISE, step=STEP))


class TestLeaveOut:
    @pytest.mark.slow
    @pytest.mark.parametrize("count", [3, 1])
    def test_a_right_model_leaves_the_noise(self, kang: CompiledModel, runs: list[Run], count: int) -> None:
        estimate = fitted(kang, runs[:count])
        found = leave_out(estimate, SETTINGS)
        assert found.parameters == 4
        assert found.count == estimate.count == sum(run.points.size for run in runs[:count])
        assert found.squares.sum() == pytest.approx(found.count, rel=0.05)
        assert found.squares.sum() > sum(residual.squares for residual in estimate.residuals), "left-out data cannot be predicted better"
        assert found.excess < 0.05
        assert 3 * count <= len(found.squares) <= 3 * 4 * max(count, 2), "blocks of about a second"

    @pytest.mark.slow
    def test_is_what_refits_say(self, kang: CompiledModel, runs: list[Run]) -> None:
        """The step from the fit to all runs against fits to two of them."""
        found = leave_out(fitted(kang, runs), SETTINGS).squares
        single = []
        for k, run in enumerate(runs):
            others = fitted(kang, [other for other in runs if other is not run])
            (residual,) = replace(others.problem, runs=(run,)).residuals(others.values)
            single.append(residual.squares)
            blocks = slice(*np.cumsum([0, *(int(r.time[-1]) + 1 for r in runs)])[k : k + 2])
            assert found[blocks].sum() == pytest.approx(single[-1], rel=0.02), run.file

    @pytest.mark.slow
    def test_what_others_do_not_tell_is_told_by_the_run_itself(self, kang: CompiledModel, runs: list[Run]) -> None:
        """The predictive distribution of linear models, by its definition: noise, and what the others leave open of the parameters."""
        estimate = fitted(kang, runs)
        first, *rest = estimate.residuals
        hardly = [replace(r, by=r.by * np.r_[1e-3, 1, 1, 1]) for r in rest]  # one parameter is told by the first run alone
        found = leave_out(replace(estimate, residuals=[first, *hardly]), SETTINGS).squares
        mean, precision = estimate.problem.prior
        others = sum(r.by.T @ r.by for r in hardly) + precision
        slope = sum(r.by.T @ r.values.ravel() for r in hardly) + precision @ (estimate.values - mean)
        plugged = first.values.ravel() - first.by @ np.linalg.solve(others, slope)
        against = first.by.T @ plugged
        expected = plugged @ plugged - against @ np.linalg.solve(others + first.by.T @ first.by, against)
        assert found[: int(first.block.max()) + 1].sum() == pytest.approx(expected, rel=1e-3)
        assert expected < 0.9 * plugged @ plugged, "the values that the others give alone say something else"

    @pytest.mark.slow
    def test_a_wrong_model_leaves_more(self, kang: CompiledModel, runs: list[Run]) -> None:
        moved = [replace(run, points=run.points + 2e-3 * np.sin(3 * run.time)[:, None, None]) for run in runs]
        assert leave_out(fitted(kang, moved), SETTINGS).excess > 1.0

    @pytest.mark.slow
    @pytest.mark.parametrize("refines", [True, False], ids=["refines", "at a bound"])
    def test_what_refines_a_form_and_what_is_at_a_bound_stay(self, kang: CompiledModel, runs: list[Run], refines: bool) -> None:
        estimate = fitted(kang, runs)
        first, *others = estimate.problem.free
        at = float(estimate.values[0])
        stays = replace(first, refines=True) if refines else replace(first, low=at)
        beside = [replace(residual, by=residual.by[:, 1:]) for residual in estimate.residuals]
        without = replace(estimate, problem=replace(estimate.problem, free=tuple(others)), values=estimate.values[1:], residuals=beside)
        found = leave_out(replace(estimate, problem=replace(estimate.problem, free=(stays, *others))), SETTINGS)
        np.testing.assert_allclose(found.squares, leave_out(without, SETTINGS).squares, rtol=1e-6)
        assert not np.allclose(found.squares, leave_out(estimate, SETTINGS).squares, rtol=1e-4), "it does move where nothing holds it"

    @pytest.mark.slow
    def test_a_run_alone_is_left_out_by_whole_blocks(self, kang: CompiledModel, runs: list[Run]) -> None:
        estimate = fitted(kang, runs[:1])
        (residual,) = estimate.residuals
        counts = np.bincount(residual.block, residual.present.reshape(len(residual.values), -1).sum(axis=1))
        np.testing.assert_array_equal(leave_out(estimate, SETTINGS).counts, counts)

    @pytest.mark.slow
    def test_a_run_that_alone_tells_of_an_effect_of_some_runs_is_cut(
        self, kang: CompiledModel, runs: list[Run], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Left out as a whole it leaves the effect as it was: that would be no test of it."""
        estimate, folds = fitted(kang, runs), []
        first, second = (free.name for free in estimate.problem.free[:2])
        alone = [replace(r, by=r.by * np.r_[there, 1, 1, 1]) for r, there in zip(estimate.residuals, (0.0, 1.0, 0.0), strict=True)]
        told = replace(estimate, residuals=alone)
        step = evidences.bounded_step
        monkeypatch.setattr(evidences, "bounded_step", lambda *asked: folds.append(1) or step(*asked))
        for estimated, names, count in ((told, {first}, 2 + 4), (told, {second}, 3), (told, set(), 3), (estimate, {first}, 3)):
            folds.clear()
            leave_out(estimated, SETTINGS, names)
            assert len(folds) == count

    @pytest.mark.slow
    def test_missing_samples_do_not_count(self, kang: CompiledModel, runs: list[Run]) -> None:
        holey = [replace(run, points=np.where(np.arange(4)[:, None] == 1, np.nan, run.points)) for run in runs]
        holey[0].points[50:120] = np.nan  # a second and a half in which nothing is seen
        found = leave_out(fitted(kang, holey), SETTINGS)
        assert found.count == sum(int(np.isfinite(run.points).sum()) for run in holey)
        assert (found.counts > 0).all()
        assert found.squares.sum() == pytest.approx(found.count, rel=0.06)


class TestWeights:
    def test_sum_to_one(self) -> None:
        found = weights([evidence(size, n, n) for n, size in enumerate((1.0, 1.01, 1.05, 3.0))], seed=1)
        assert found.sum() == pytest.approx(1.0)
        assert (found >= 0).all()

    def test_equal_ones_share(self) -> None:
        assert weights([evidence(), evidence(), evidence()], seed=1) == pytest.approx(np.full(3, 1 / 3))

    def test_a_better_one_wins(self) -> None:
        assert weights([evidence(1.2, seed=1), evidence(seed=2), evidence(2.0, seed=3)], seed=1)[1] > 0.99

    def test_a_parameter_must_earn_its_place(self) -> None:
        simple, rich = weights([evidence(parameters=4), evidence(parameters=7)], seed=1)
        assert rich / simple == pytest.approx(BLOCKS**-1.5, rel=1e-6)

    def test_what_is_gained_in_a_single_second_may_be_chance(self) -> None:
        """The same gain counts for more where it is spread over the data: the bootstrap is over blocks."""
        even, counts = np.full(BLOCKS, float(SAMPLES)), np.full(BLOCKS, SAMPLES)
        gain = 12.0
        at_once = weights([made(even - gain * (np.arange(BLOCKS) == 3), counts), made(even, counts)], seed=1)[0]
        spread = weights([made(even - gain / BLOCKS, counts), made(even, counts)], seed=1)[0]
        assert spread == pytest.approx(1 / (1 + np.exp(-gain / 2)), abs=1e-6)
        assert 0.75 < at_once < 0.95 < spread

    def test_alone(self) -> None:
        assert weights([evidence(2.0)], seed=1) == pytest.approx([1.0])

    def test_repeatable_by_seed(self) -> None:
        pair = [evidence(seed=1), evidence(seed=2)]
        np.testing.assert_array_equal(weights(pair, 3), weights(pair, 3))
        assert not np.array_equal(weights(pair, 3), weights(pair, 4))


def test_excess_and_spread() -> None:
    loud, quiet = made(np.array([10.0, 30.0]), np.array([10, 10])), made(np.array([5.0]), np.array([10]))
    assert (loud.excess, loud.spread) == pytest.approx((1.0, 2.0))
    assert (quiet.excess, quiet.spread) == (0.0, 1.0), "less than the noise is no structure"

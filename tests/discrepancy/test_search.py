"""The library, the search and the files it leaves, on a tiny data set in which the holder of s3 is off."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.adapters.network import candidate, candidates, with_all_candidates, with_selected_candidates
from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.reporting.sentences import rejection_reason
from tepm_opt.discrepancy.selection.fitting import Fits
from tepm_opt.discrepancy.selection.forward_backward import explain
from tepm_opt.discrepancy.selection.linearised import linearise
from tepm_opt.discrepancy.selection.screening import screen
from tepm_opt.discrepancy.state import Discovery
from tepm_opt.errors import InputError
from tepm_opt.jobs.discrepancy import FITS, MODEL, VERDICT, run_discrepancy
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.effects import effects
from tepm_opt.models.layout import Layout
from tepm_opt.models.model import Model, read_model
from tepm_opt.solvers.identification.identify import Problem, identify
from tepm_opt.solvers.mechanics.network_plant import NetworkPlant, free_parameters
from tepm_opt.solvers.mechanics.predict import predict
from tepm_opt.solvers.numerics import parallel
from tests.discrepancy.small import NOISE, STEP, changed, cut, dataset_of, measured, planned, true_values, write
from tests.tools import stages_into

NOMINAL = Model.from_robot("kang2017")
OFFSET = np.array([4e-3, -3e-3, 2e-3])  # m, of s3
FILES = ("single_pressure.csv", "elongation.csv", "mixed.csv")
SETTINGS = SearchSettings()


@pytest.fixture(scope="module")
def runs(kang: CompiledModel) -> list[Run]:
    found = [cut(run, 3.0) for run in measured(changed(kang, **true_values(kang)), planned(FILES))]
    return [replace(run, points=run.points + OFFSET * (np.arange(4) == 2)[:, None]) for run in found]


@pytest.fixture(scope="module")
def folder(kang: CompiledModel, runs: list[Run], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(dataset_of(kang, runs), tmp_path_factory.mktemp("offset"))


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("out")


@pytest.fixture(scope="module")
def lines() -> list[str]:
    return []


@pytest.fixture(scope="module")
def result(folder: Path, out: Path, lines: list[str]) -> Discovery:
    """The answer; `lines` are what it told meanwhile."""
    return run_discrepancy(folder, out, progress=stages_into(lines))


@pytest.fixture(scope="module")
def library() -> CompiledModel:
    return compile_model(with_all_candidates(NOMINAL, candidates(NOMINAL)))


def problem(library: CompiledModel, runs: list[Run]) -> Problem:
    return Problem(NetworkPlant(library), tuple(run for run in runs if run.role == "fit"), free_parameters(library), NOISE)


def contents(folder: Path) -> tuple[dict[str, Any], str]:
    """verdict.json but for the time it took and where it is, and model.toml."""
    verdict = json.loads((folder / VERDICT).read_text().replace(str(folder), "OUT"))
    assert verdict.pop("seconds") > 0
    return verdict, (folder / MODEL).read_text()


class TestLibrary:
    def test_every_effect_with_every_detail(self) -> None:
        found = candidates(NOMINAL)
        layout = Layout.from_robot(NOMINAL.robot)
        assert {candidate.name for candidate in found} == {effect.name for effect in effects()}
        assert {c.detail for c in found if c.name == "actuator_gain"} == set(layout.actuator_names)
        assert {c.detail for c in found if c.name == "sensor_offset"} == set(layout.point_names)
        assert len({candidate.label for candidate in found}) == len(found)

    def test_without_what_the_model_has(self) -> None:
        known = NOMINAL.with_effect("payload", mass=0.01).with_effect("actuator_gain", "13", loss=0.1)
        labels = {candidate.label for candidate in candidates(known)}
        assert {candidate.label for candidate in candidates(NOMINAL)} - labels == {"payload", "actuator_gain[13]"}

    @pytest.mark.slow
    def test_all_effects_at_their_null_values_change_nothing(self, kang: CompiledModel, library: CompiledModel, runs: list[Run]) -> None:
        for static in (False, True):
            run = cut(runs[0], 0.5 if static else 3.0)
            found, nominal = (predict(model, run, static=static, step=STEP).points for model in (library, kang))
            assert np.abs(found - nominal).max() < (1e-10 if static else 5e-7), "up to what the tolerance of a step leaves"

    def test_narrow_undoes_wide(self) -> None:
        assert with_selected_candidates(NOMINAL, with_all_candidates(NOMINAL, candidates(NOMINAL)).values, ()) == NOMINAL
        known = NOMINAL.with_effect("payload", mass=0.01)
        missing = candidates(known)
        values = {**with_all_candidates(known, missing).values, "K_a": 350.0, "payload.mass": 0.02, "sensor_offset[s3].x": 1e-3}
        found = with_selected_candidates(known, values, [candidate("sensor_offset", "s3")])
        assert found.parameters == {"K_a": 350.0}
        assert found == NOMINAL.with_parameters(K_a=350.0).with_effect("payload", mass=0.02).with_effect(
            "sensor_offset", "s3", x=1e-3, y=0.0, z=0.0
        )

    def test_narrow_bears_rounding_at_a_bound(self) -> None:
        """A value plus the step to its bound is not always the bound."""
        zone = candidate("pressure_dead_zone", None)
        low = 0.02
        values = {
            **with_all_candidates(NOMINAL, [zone]).values,
            "pressure_dead_zone.threshold": 2e4,
            "pressure_dead_zone.rounding": np.nextafter(low, 0),
        }
        assert with_selected_candidates(NOMINAL, values, [zone]).values["pressure_dead_zone.rounding"] == low

    def test_probes_differ_from_nulls(self) -> None:
        for missing in candidates(NOMINAL):
            assert missing.probes[0].keys() == missing.null.keys() == set(missing.parameters)
            assert missing.probes[0] != missing.null, missing.label

    def test_what_one_actuator_does_a_gauge_may_show(self) -> None:
        """Whatever the hook it is written with: a muscle's offset may be its regulator's zero."""
        stages = {candidate.name: candidate.stage for candidate in candidates(NOMINAL)}
        assert stages["actuator_offset"] == stages["actuator_gain"] == stages["regulator_lag"] == "input"
        assert stages["payload"] == stages["sensor_offset"] == "body"


@pytest.mark.slow
class TestScreening:
    @pytest.mark.parametrize("apart", [0.0, 0.04])
    def test_what_is_missing_promises_most(self, library: CompiledModel, runs: list[Run], apart: float) -> None:
        estimate = identify(replace(problem(library, runs), derivatives_apart=apart))
        scores = screen(linearise(estimate, estimate.problem.free, (), candidates(NOMINAL), SETTINGS), SETTINGS)
        gains = [score.gain for score in scores]
        assert gains == sorted(gains, reverse=True)
        assert scores[0].candidate.label == "sensor_offset[s3]"
        assert scores[0].gain == pytest.approx(1.0, abs=0.02)
        start = [scores[0].start[f"sensor_offset[s3].{axis}"] for axis in "xyz"]
        assert start == pytest.approx(OFFSET, abs=2e-4)
        assert max(gains[1:]) < 0.9

    def test_a_slow_valve_shows_at_a_large_size(self, library: CompiledModel) -> None:
        """Its derivatives where it does nothing promise hardly anything."""
        lag = {"regulator_lag.filling_time": 4.0, "regulator_lag.exhausting_time": 4.0}
        slow = [cut(run, 6.0) for run in measured(changed(library, **lag), planned(FILES)[:2])]
        estimate = identify(problem(library, slow))
        linear = linearise(estimate, estimate.problem.free, (), candidates(NOMINAL), SETTINGS)
        (found,) = (score for score in screen(linear, SETTINGS) if score.candidate.label == "regulator_lag")
        (near,) = (c for c in linear.able if c.label == "regulator_lag")
        assert near.smooth
        assert found.gain > max(0.5, 2 * linear.gain((near,))[0])
        assert found.start["regulator_lag.filling_time"] > 0.5

    def test_every_other_sample_says_the_same(self, library: CompiledModel, runs: list[Run]) -> None:
        """First-order gains of all effects, those that are probed as well."""
        estimate = identify(problem(library, runs))
        sparse = replace(estimate, problem=replace(estimate.problem, derivatives_apart=0.04))
        whole, few = (
            {s.candidate.label: s for s in screen(linearise(each, each.problem.free, (), candidates(NOMINAL), SETTINGS), SETTINGS)}
            for each in (estimate, sparse)
        )
        assert whole.keys() == few.keys()
        gains = {label: (score.gain, few[label].gain) for label, score in whole.items()}
        assert all(other == pytest.approx(one, abs=0.02) for one, other in gains.values()), gains


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        SearchSettings(max_iterations=1, max_effects=0),
        SearchSettings(max_iterations=1, max_noise_excess=1e6),
        SearchSettings(max_iterations=1, fits_first_round=0),
    ],
    ids=["no effects", "all of it noise", "no fits"],
)
def test_a_search_that_may_not_try_fits_known_parameters_only(library: CompiledModel, runs: list[Run], settings: SearchSettings) -> None:
    missing = [candidate("sensor_offset", "s3")]
    found = explain(Fits(problem(library, runs), settings), missing, 0)
    assert found.tried == [found.without]
    assert found.best is found.without
    assert found.without.excess > 1


@pytest.mark.slow
class TestFits:
    def test_are_done_once(self, library: CompiledModel, runs: list[Run], tmp_path: Path) -> None:
        said: list[str] = []
        fits = Fits(
            problem(library, runs),
            SearchSettings(max_iterations=2),
            tmp_path / "fits.json",
            "key",
            stages_into(said),
        )
        first = fits.fit((), {})
        assert first is not None
        assert set(said) == {"fitting the known parameters"}
        count = len(said)
        assert fits.fit((), {}) is first
        assert len(said) == count
        again = Fits(problem(library, runs), SearchSettings(max_iterations=2), tmp_path / "fits.json", "key").fit((), {})
        assert again is not None
        np.testing.assert_array_equal(again.estimate.values, first.estimate.values)
        np.testing.assert_array_equal(again.evidence.squares, first.evidence.squares)
        assert again.estimate.iterations == 0

    def test_anew_keep_the_better(self, library: CompiledModel, runs: list[Run]) -> None:
        """A fit that is done is not made again from other values, unless it is asked for."""
        effect = candidate("sensor_offset", "s3")
        fits = Fits(problem(library, runs), SearchSettings(max_iterations=1))
        far, near = ({f"{effect.label}.x": x, f"{effect.label}.turns": turns} for x, turns in ((-0.1, 1.0), (OFFSET[0], 0.0)))
        astray = fits.fit((effect,), far)
        assert fits.fit((effect,), near) is astray is fits.find((effect,))
        found = fits.refit((effect,), near)
        assert found is not None
        assert astray is not None
        assert found.excess < astray.excess
        assert fits.refit((effect,), far) is found is fits.find((effect,))

    def test_begin_no_worse_than_those_of_fewer_effects(self, library: CompiledModel, runs: list[Run]) -> None:
        """First values that leave more than no effect are drawn towards none, where there is a fit without it."""
        effect, settings = candidate("sensor_offset", "s3"), SearchSettings(max_iterations=0)
        far = {f"{effect.label}.x": 5 * OFFSET[0]}
        fits = Fits(replace(problem(library, runs), derivatives_apart=0.04), settings)
        nothing, shortened = fits.fit((), {}), fits.fit((effect,), far)
        astray = Fits(replace(problem(library, runs), derivatives_apart=0.04), settings).fit((effect,), far)
        assert nothing is not None
        assert shortened is not None
        assert astray is not None
        assert shortened.estimate.cost < nothing.estimate.cost < astray.estimate.cost

    def test_that_ended_early_go_on_when_asked_for(self, library: CompiledModel, runs: list[Run]) -> None:
        fits = Fits(problem(library, runs), SearchSettings())
        right, wrong = (fits.fit((candidate(name, detail),), {}) for name, detail in (("sensor_offset", "s3"), ("sensor_offset", "s1")))
        assert right is not None
        assert wrong is not None
        hasty = Fits(problem(library, runs), SearchSettings())
        (early,) = hasty.fit_all([(wrong.effects, {})], rival=right)
        assert early is not None
        assert early.estimate.out_of_reach
        assert early.estimate.iterations < wrong.estimate.iterations
        assert hasty.fit_all([(wrong.effects, {})], rival=right) == [early]
        last = hasty.complete(early)
        assert not last.estimate.out_of_reach
        assert last.excess == pytest.approx(wrong.excess, rel=1e-4)
        assert hasty.complete(last) is last

    def test_that_end_early_do_not_change_the_winner(self, library: CompiledModel, runs: list[Run]) -> None:
        settings = SearchSettings(tolerance=1e-7, far_rival_ratio=np.inf)  # so that all are fitted and have steps to make
        found = []
        for ratio in (settings.early_end_ratio, np.inf):
            own = replace(settings, early_end_ratio=ratio)
            found.append(explain(Fits(problem(library, runs), own), candidates(NOMINAL), 0))
        early, whole = found
        ended = [hypothesis for hypothesis in early.tried if hypothesis.estimate.out_of_reach]
        assert ended
        assert all("leaves at most " in rejection_reason(early, candidate("sensor_offset", "s3"), hypothesis) for hypothesis in ended)
        assert not any(hypothesis.estimate.out_of_reach for hypothesis in whole.tried)
        assert early.best.effects == whole.best.effects == (candidate("sensor_offset", "s3"),)
        np.testing.assert_array_equal(early.best.estimate.values, whole.best.estimate.values)
        np.testing.assert_array_equal(early.best.evidence.squares, whole.best.evidence.squares)
        assert early.shares == whole.shares
        chances = [[weight for _, weight in group] for found in (early, whole) for group in found.groups.values()]
        assert chances[0] == pytest.approx(chances[1], abs=1e-9)

    @pytest.mark.parametrize("left", ['{"key": "other", "fit ": {"K_a": 349.0}}', "{", "[]", "\x00"])
    def test_of_other_data_are_not_taken(self, library: CompiledModel, runs: list[Run], tmp_path: Path, left: str) -> None:
        (tmp_path / "fits.json").write_text(left)
        fits = Fits(problem(library, runs), SearchSettings(max_iterations=1), tmp_path / "fits.json", "key")
        found = fits.fit((), {})
        assert found is not None
        assert found.estimate.iterations == 1
        assert json.loads((tmp_path / "fits.json").read_text())["key"] == "key"


@pytest.mark.slow
class TestAnswer:
    def test_names_what_is_hidden(self, result: Discovery) -> None:
        verdict = result.verdict
        assert verdict.status is VerdictStatus.NAMED, verdict.paragraph
        (named,) = verdict.effects
        assert named.candidate == candidate("sensor_offset", "s3")
        assert named.probability > 0.9
        found = np.array([named.parameters[axis].value for axis in "xyz"])
        std = np.array([named.parameters[axis].std for axis in "xyz"])
        assert (np.abs(found - OFFSET) < 4 * std + 5e-5).all(), (found, std)
        assert verdict.errors.gap_closed_fraction > 0.97
        assert verdict.model.effects[0].name == "sensor_offset"

    def test_every_other_effect_is_a_rival_with_a_reason(self, result: Discovery) -> None:
        rivals = {rival.candidate.name: rival for rival in result.verdict.rivals}
        assert set(rivals) == {effect.name for effect in effects()} - {"sensor_offset"} | {"parameter"}
        assert all(rival.why for rival in rivals.values())
        for effect, group in result.explanation.groups.items():
            assert sum(weight for _, weight in group) == pytest.approx(1.0), effect

    def test_files(self, result: Discovery, out: Path) -> None:
        assert sorted(path.name for path in out.iterdir()) == sorted([VERDICT, MODEL])
        verdict, _ = contents(out)
        assert verdict["status"] == "named"
        assert verdict["effects"][0]["name"] == "sensor_offset"
        assert set(verdict["rmse_m"]) == {"noise_floor", "nominal", "recalibrated", "corrected", "black_box"}
        found = read_model(out / MODEL)
        assert replace(found, filter={}) == result.verdict.model
        assert found.filter == {"strength_std": 0.015, "strength_drift": 0.0015}

    def test_is_the_same_after_an_interruption(self, folder: Path, out: Path, result: Discovery, lines: list[str], tmp_path: Path) -> None:
        work = [line for line in lines if line.startswith(("fitting", "screening", "judging"))]
        assert len(work) >= 4, work
        said: list[str] = []

        def interrupt(stage: str, done: float, of: float) -> None:
            said.append(stage)
            if len([line for line in said if line.startswith(("fitting", "screening", "judging"))]) == len(work):
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            run_discrepancy(folder, tmp_path, progress=interrupt)
        assert [path.name for path in tmp_path.iterdir()] == [FITS]
        again: list[str] = []
        run_discrepancy(folder, tmp_path, progress=stages_into(again))
        assert contents(tmp_path) == contents(out)
        assert not (tmp_path / FITS).exists()

    @pytest.mark.parametrize("cores", [1, 3])
    def test_is_the_same_again_on_so_many_cores(
        self, folder: Path, out: Path, result: Discovery, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cores: int
    ) -> None:
        monkeypatch.setattr(parallel, "cores", lambda: cores)
        again = run_discrepancy(folder, tmp_path)
        texts = [(each / VERDICT).read_text().rsplit('"seconds"', 1)[0].replace(str(each), "OUT") for each in (out, tmp_path)]
        assert texts[0] == texts[1]
        assert (out / MODEL).read_bytes() == (tmp_path / MODEL).read_bytes()
        for one, other in zip(result.explanation.tried, again.explanation.tried, strict=True):
            assert one.effects == other.effects
            np.testing.assert_array_equal(one.estimate.values, other.estimate.values)

    def test_with_the_effect_known_nothing_is_missing(self, folder: Path, out: Path, result: Discovery, tmp_path: Path) -> None:
        verdict = run_discrepancy(folder, tmp_path, out / MODEL).verdict
        assert verdict.status is VerdictStatus.NO_DISCREPANCY, verdict.paragraph
        assert verdict.model.effects[0].name == "sensor_offset", "what the model had is kept"

    def test_a_model_of_another_robot(self, folder: Path, tmp_path: Path) -> None:
        text = (Path(__file__).parents[2] / "tepm_opt/models/robots/kang2017.toml").read_text()
        (tmp_path / "one.toml").write_text(text.replace("modules = 2", "modules = 1"))
        (tmp_path / "model.toml").write_text('robot = "one.toml"\n')
        with pytest.raises(InputError, match="other actuators or reference points"):
            run_discrepancy(folder, tmp_path / "out", tmp_path / "model.toml")
        assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_value_that_ends_at_its_limit_is_tried_alone(kang: CompiledModel, tmp_path: Path) -> None:
    """To first order, five effects promise more than the one wrong value that they would stand for."""
    stiff = changed(kang, **{**true_values(kang), "K_a": 1.065 * kang.robot.parameters.K_a})
    runs = [cut(run, 3.0) for run in measured(stiff, planned(FILES))]
    verdict = run_discrepancy(write(dataset_of(kang, runs), tmp_path / "stiff"), tmp_path / "out").verdict
    assert verdict.status is VerdictStatus.NAMED, verdict.paragraph
    (named,) = verdict.effects
    assert named.candidate.label == "parameter[K_a]"
    value = named.parameters["K_a"]
    assert abs(value.value - 1.065 * kang.robot.parameters.K_a) < 4 * value.std

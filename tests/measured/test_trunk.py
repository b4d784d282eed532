"""A tendon trunk with a hidden payload that others measured: what changed between two recordings."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.trials import Trials, read_trials
from tepm_opt.discrepancy.adapters.casadi_plant import CasadiPlant
from tepm_opt.discrepancy.assessment.result import Verdict, VerdictStatus
from tepm_opt.discrepancy.baseline.baseline import Baseline
from tepm_opt.discrepancy.pipeline import discover, learn_baseline
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.setup.check import find_setup_errors
from tepm_opt.discrepancy.state import Question
from tepm_opt.jobs.plants import load_plant
from tests.measured.prepared import EXAMPLES
from tests.paths import SHARED

NOISE = 8e-6  # m

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def plant() -> CasadiPlant:
    return load_plant(EXAMPLES / "trunk.py")  # type: ignore[return-value]


def recorded(plant: CasadiPlant, folder: Path, grams: int, part: tuple[float, float] = (0.0, 1.0)) -> Trials:
    if not (SHARED / "real" / "trunk").is_dir():
        pytest.skip(f"the trunk's recordings are not in {SHARED}")
    sys.path.insert(0, str(EXAMPLES))
    from measured_trunk import trunk

    trunk(SHARED, folder, f"servo/driven_{grams}g.csv", part)
    return read_trials(folder, plant.signals)


def learned(plant: CasadiPlant, old: Trials) -> Baseline:
    return learn_baseline(Question(old, plant, NOISE, SearchSettings.for_plant(plant)))


@pytest.fixture(scope="module")
def empty(plant: CasadiPlant, tmp_path_factory: pytest.TempPathFactory) -> Baseline:
    return learned(plant, recorded(plant, tmp_path_factory.mktemp("0g"), 0))


@pytest.fixture(scope="module")
def loaded(plant: CasadiPlant, empty: Baseline, tmp_path_factory: pytest.TempPathFactory) -> dict[int, Verdict]:
    """Verdicts by payload in g."""
    runs = {grams: recorded(plant, tmp_path_factory.mktemp(f"{grams}g"), grams) for grams in (100, 300)}
    return {grams: discover(run, plant, NOISE, baseline=empty).verdict for grams, run in runs.items()}


def test_the_error_of_a_coarse_model_is_no_mistake_of_the_set_up(plant: CasadiPlant, tmp_path: Path) -> None:
    """Exchanged motors would take 12 % of it away, as the guessed gains are rough."""
    assert find_setup_errors(plant, recorded(plant, tmp_path, 0).runs, NOISE)[0] == ()


def test_nothing_changed_from_the_first_half_to_the_second(plant: CasadiPlant, tmp_path: Path) -> None:
    before, after = recorded(plant, tmp_path / "a", 0, (0.0, 0.5)), recorded(plant, tmp_path / "b", 0, (0.5, 1.0))
    verdict = discover(after, plant, NOISE, baseline=learned(plant, before)).verdict
    assert verdict.status is VerdictStatus.NO_DISCREPANCY, verdict


@pytest.mark.parametrize("grams", [100, 300])
def test_a_payload_and_nothing_else_is_named(loaded: dict[int, Verdict], grams: int) -> None:
    named = {effect.candidate.label: effect.probability for effect in loaded[grams].effects}
    assert named.pop("payload[tip]", 0.0) >= 0.8, loaded[grams]
    assert all(probability < 0.5 for probability in named.values())


def test_sizes_are_as_the_payloads(loaded: dict[int, Verdict]) -> None:
    """One known payload sets the scale: the trunk's own mass is not known."""
    light, heavy = (loaded[grams].effects[0].parameters["mass"] for grams in (100, 300))
    found = 100 * heavy.value / light.value
    std = found * float(np.hypot(heavy.std / heavy.value, light.std / light.value))
    assert abs(found - 300) < 1.96 * std
    assert abs(found - 300) < 45


def test_without_the_law_the_change_is_unexplained(plant: CasadiPlant, empty: Baseline, tmp_path: Path) -> None:
    without = replace(plant, candidates=tuple(c for c in plant.candidates if c.name != "payload"))
    verdict = discover(recorded(plant, tmp_path, 300), without, NOISE, baseline=empty).verdict
    assert verdict.status in (VerdictStatus.UNEXPLAINED, VerdictStatus.PARTIAL), verdict
    assert all(effect.probability < 0.8 for effect in verdict.effects)

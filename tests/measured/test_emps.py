"""A linear drive that others measured: dry friction and a constant force and nothing else, into whatever columns its force is written."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
from scipy.signal import butter, filtfilt

from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.discrepancy.state import Discovery
from tepm_opt.jobs.discrepancy import run_discrepancy
from tests.measured.prepared import EXAMPLES, prepared
from tests.paths import SHARED

pytestmark = pytest.mark.slow
STEP, CUT = 1e-3, 100  # s; samples at each end that filters spoil
PULSES, RATIO = 6e-3, 1.03  # m r.m.s.; of relative force errors
ENCODINGS = ("emps", "emps_tip_force", "emps_guide")


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Discovery]:
    """The answers for all three ways of writing the force down."""
    folder = tmp_path_factory.mktemp("emps")
    return {
        name: run_discrepancy(prepared(name, folder / name), folder / f"{name} out", plant=EXAMPLES / f"{name}.py") for name in ENCODINGS
    }


def measured(run: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, motor force and position of a run, as the example reads them."""
    spec = importlib.util.spec_from_file_location("measured_emps", EXAMPLES / "measured_emps.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.measured(SHARED, run)


def filtered(values: np.ndarray, hertz: float) -> np.ndarray:
    """Zero phase, Butterworth of order 4."""
    return np.asarray(filtfilt(*butter(4, hertz * 2 * STEP), values, axis=0))


def regression(run: str) -> tuple[np.ndarray, np.ndarray]:
    """Regressors (acceleration, speed, its sign, 1), (samples, 4), and force in N.

    Position at 50 Hz, central differences, then force and regressors alike at 20 Hz.
    """
    _, force, position = measured(run)
    speed = np.gradient(filtered(position, 50.0), STEP)
    columns = np.stack([np.gradient(speed, STEP), speed, np.sign(speed), np.ones_like(speed)], axis=1)
    return filtered(columns, 20.0)[CUT:-CUT], filtered(force, 20.0)[CUT:-CUT]


def force_error(parameters: np.ndarray, run: str) -> float:
    """Relative error of the force of the four-term model."""
    columns, force = regression(run)
    return float(np.linalg.norm(force - columns @ parameters) / np.linalg.norm(force))


@pytest.mark.parametrize("name", ENCODINGS)
def test_friction_and_a_constant_force_and_nothing_else(found: dict[str, Discovery], name: str) -> None:
    verdict = found[name].verdict
    assert {each.candidate.label for each in verdict.effects} == {"dry_friction[slide]", "constant_force[slide]"}, verdict.paragraph
    assert verdict.status is VerdictStatus.PARTIAL, verdict.paragraph
    assert all(rival.probability <= 0.5 for rival in verdict.rivals)
    assert all(0.5 < each.probability < 0.99 for each in verdict.effects), "ten times the noise is left: nothing is sure"


@pytest.mark.parametrize("name", ENCODINGS[1:])
def test_every_encoding_gives_the_same_answer(found: dict[str, Discovery], name: str) -> None:
    one, other = found["emps"].verdict, found[name].verdict
    assert [each.candidate for each in other.effects] == [each.candidate for each in one.effects]
    for each, same in zip(other.effects, one.effects, strict=True):
        assert each.probability == pytest.approx(same.probability, abs=0.01)
        assert each.parameters["force"].value == pytest.approx(same.parameters["force"].value, rel=0.01)


@pytest.mark.parametrize("name", ENCODINGS)
def test_force_and_motion_of_other_data(found: dict[str, Discovery], name: str) -> None:
    """Parameters as found, nothing fitted to the pulses: as good as least squares on the force itself; the motion from the first state."""
    verdict = found[name].verdict
    sizes = {each.candidate.name: each.parameters["force"].value for each in verdict.effects}
    known = {name: value.value for name, value in verdict.recalibrated.items()}
    ours = np.array([known["mass"], known["viscous"], sizes["dry_friction"], -sizes["constant_force"]])
    best = np.linalg.lstsq(*regression("estimation"), rcond=None)[0]
    assert force_error(best, "pulses") == pytest.approx(0.044, abs=0.001), "what is published, with this filter"
    assert force_error(ours, "pulses") <= RATIO * force_error(best, "pulses")
    assert verdict.errors.corrected <= PULSES

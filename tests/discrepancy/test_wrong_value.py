"""A value of the robot file that is far off is found as it is, not at the end of a range."""

from __future__ import annotations

from pathlib import Path

import pytest

from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.jobs.discrepancy import run_discrepancy
from tepm_opt.models.compile import compile_model
from tepm_opt.models.model import Model
from tests.discrepancy.small import changed, dataset_of, measured, planned, true_values, write


@pytest.mark.slow
@pytest.mark.parametrize(("name", "factor"), [("c_a", 0.25), ("alpha_2", 0.3)])
def test_a_value_a_quarter_of_the_file_is_found(name: str, factor: float, tmp_path: Path) -> None:
    model = compile_model(Model.from_robot("kang2017"))
    true = true_values(model) | {name: factor * getattr(model.robot.parameters, name)}
    folder = write(dataset_of(model, measured(changed(model, **true), planned())), tmp_path / "data")
    found = run_discrepancy(folder, tmp_path / "out").verdict
    assert found.status is VerdictStatus.NAMED
    [effect] = found.effects
    assert effect.candidate.label == f"parameter[{name}]"
    assert effect.parameters[name].value == pytest.approx(true[name], rel=0.02)

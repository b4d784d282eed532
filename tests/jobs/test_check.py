"""The check of a data set by simulations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from tepm_opt.jobs.check import run_check
from tepm_opt.models.compile import CompiledModel
from tests.discrepancy.small import changed, dataset_of, measured, planned, true_values, write


def test_exchanged_hoses_are_told_and_what_cannot_be_told_from_them(kang: CompiledModel, tmp_path: Path) -> None:
    """Without tension, two exchanged actuators look the same."""
    order = [1, 0, *range(2, 12)]
    runs = measured(changed(kang, **true_values(kang)), planned(("single_pressure.csv",)))
    found = run_check(write(dataset_of(kang, [replace(run, inputs=run.inputs[:, order]) for run in runs]), tmp_path / "data"))
    setup = {(each.severity, each.channel) for each in found.findings if each.is_setup}
    hoses, tendons = "pressure_11_Pa pressure_12_Pa", "tension_11_N tension_12_N"
    assert setup == {("error", hoses), ("warning", f"{hoses} {tendons}")}
    assert not found.ok

"""Memory of a verdict grows slowly with the data: 20 minutes at 50 Hz, 60,000 samples, have to fit in 1 GB with all that is imported."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.adapters.network import SearchableNetwork
from tepm_opt.discrepancy.assessment import validation
from tepm_opt.discrepancy.assessment.settings import AssessmentSettings
from tepm_opt.discrepancy.pipeline import DiscoverOptions, discover
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.model import Model
from tests.discrepancy.small import NOISE, changed, cut, dataset_of, measured, planned, true_values

PER_SAMPLE = 2500  # B; 150 MB for 20 minutes


@pytest.mark.slow
def test_of_a_verdict_per_sample(kang: CompiledModel, monkeypatch: pytest.MonkeyPatch) -> None:
    small_ones = AssessmentSettings(black_box_samples=50, location_chunk=20_000)  # what does not grow any more with long data
    monkeypatch.setattr(validation, "predict_residuals", partial(validation.predict_residuals, settings=small_ones))
    monkeypatch.setattr(validation, "localise", partial(validation.localise, settings=small_ones))
    runs = measured(changed(kang, **true_values(kang)), planned(("single_pressure.csv", "elongation.csv", "mixed.csv")))
    runs = [replace(cut(run, 6.0), points=cut(run, 6.0).points + 3e-3 * (np.arange(4) == 2)[:, None]) for run in runs]

    settings = SearchSettings(max_derivative_bytes=2_000_000)  # as if the data were long: one fit at a time, on thinned data

    def peak(copies: int) -> tuple[int, int]:
        """Samples of so many copies of the runs, and the most memory in B their verdict takes."""
        every: list[Run] = [replace(run, file=f"{copy}_{run.file}") for run in runs for copy in range(copies)]
        dataset = dataset_of(kang, every)
        tracemalloc.start()
        try:
            discover(
                dataset,
                SearchableNetwork.from_model(Model.from_robot("kang2017"), dataset.channels),
                NOISE,
                options=DiscoverOptions(settings=settings),
            )
            return sum(run.rows for run in every), tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak(1)  # what is imported and compiled once
    (few, small), (many, large) = peak(1), peak(4)
    assert (large - small) / (many - few) < PER_SAMPLE

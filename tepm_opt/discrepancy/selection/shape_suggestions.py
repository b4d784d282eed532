"""Shapes (instants, rates) of missing effects, suggested by the residuals of a fit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.solvers.identification.identify import ParameterEstimate


def apply_suggested_shapes(estimate: ParameterEstimate, missing: Iterable[Candidate]) -> ParameterEstimate:
    """The estimate with the shapes of missing effects as its residuals suggest them; at their null values these change nothing."""
    wanting = [candidate.suggested for candidate in missing if candidate.suggested is not None]
    runs = sorted(zip(estimate.problem.runs, estimate.residuals, strict=True), key=lambda pair: pair[0].began)
    if not wanting or estimate.problem.plant.static:
        return estimate
    clock = np.concatenate([run.began + run.time - run.time[0] for run, _ in runs])
    began = np.concatenate([np.full(run.rows, run.began) for run, _ in runs])
    left = np.concatenate([residual.values.reshape(run.rows, -1) for run, residual in runs])
    values = {name: value for suggest in wanting for name, value in suggest(clock, began, left).items()}
    return replace(estimate, problem=replace(estimate.problem, plant=estimate.problem.plant.with_values(values)))

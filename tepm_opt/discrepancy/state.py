"""States of the pipeline: each stage adds what it found to the state before it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tepm_opt.data.run import RunSet
from tepm_opt.discrepancy.assessment.credibility import Judgement
from tepm_opt.discrepancy.assessment.residual_locations import Localisation
from tepm_opt.discrepancy.assessment.result import Errors, Verdict
from tepm_opt.discrepancy.assessment.stated_set import CauseScores
from tepm_opt.discrepancy.baseline.baseline import Baseline
from tepm_opt.discrepancy.preparation.clock import ClockShift
from tepm_opt.discrepancy.preparation.devices import IdentifiedDevices
from tepm_opt.discrepancy.problem.plant import Candidate, SearchablePlant
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.problem.time_limit import TimeLimit
from tepm_opt.discrepancy.selection.fitting import Fits
from tepm_opt.discrepancy.selection.forward_backward import Explanation
from tepm_opt.discrepancy.setup.errors import SetupError
from tepm_opt.discrepancy.symbolic.invent import Invention
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.identification.identify import ParameterEstimate, Problem
from tepm_opt.solvers.numerics.text import shorten


@dataclass(frozen=True, eq=False)
class Question:
    """A data set and a model of its machine.

    Attributes:
        dataset: checked data.
        plant: the model, with the effects that may be missing at their null values.
        noise: of the measurements, 1 sigma per axis in m, or of each point, (points, 1).
        settings: thresholds of the search.
        seed: of all random draws.
        store: file that keeps the fits, so that an interrupted search can go on; None keeps nothing.
        key: content of `store` is used only if it was made with the same key.
        progress: told of every piece of work.
        setup: errors of the set-up that are mended in `dataset`.
        baseline: an earlier recording of the machine, from which the answer tells what changed; None for none.
        limit: time that the search may take.
    """

    dataset: RunSet
    plant: SearchablePlant
    noise: float | np.ndarray
    settings: SearchSettings
    seed: int = 0
    store: Path | None = None
    key: str = ""
    progress: Progress = silent
    setup: tuple[SetupError, ...] = ()
    baseline: Baseline | None = None
    limit: TimeLimit = field(default_factory=TimeLimit)


@dataclass(frozen=True, eq=False)
class Prepared(Question):
    """Data without outliers, and the least-squares problem of recalibration.

    Attributes:
        nominal: predictions of the model as it was, (rows, points, 3) in m a run.
        open_candidates: those that measured inputs do not exclude.
        devices: lag, delay and grid of the regulators where gauges show them.
        problem: with the known parameters free.
        remarks: sentences for the reader.
    """

    nominal: list[np.ndarray] = field(kw_only=True)
    open_candidates: Sequence[Candidate] = field(kw_only=True)
    devices: IdentifiedDevices | None = field(kw_only=True)
    problem: Problem = field(kw_only=True)
    remarks: list[str] = field(kw_only=True)


@dataclass(frozen=True, eq=False)
class Recalibrated(Prepared):
    """The fit of the known parameters alone, and the noise that it shows.

    Attributes:
        fits: of the search, beginning with this one.
    """

    fits: Fits = field(kw_only=True)


@dataclass(frozen=True, eq=False)
class Screened(Recalibrated):
    """Candidates that are left to the selection.

    Attributes:
        candidates: without those that measured inputs exclude.
    """

    candidates: Sequence[Candidate] = field(kw_only=True)


@dataclass(frozen=True, eq=False)
class Selected(Screened):
    """The selected set of effects.

    Attributes:
        explanation: all fits of the search.
    """

    explanation: Explanation = field(kw_only=True)


@dataclass(frozen=True, eq=False)
class Validated(Selected):
    """Predictions of the nominal, the recalibrated and the corrected model for all runs.

    Attributes:
        predictions: by "nominal", "recalibrated" and "corrected", (rows, points, 3) in m a run.
        black_box: points of the validation runs as a black box predicts them.
        localisation: where the model misses.
        best: the selected fit with the precise time step.
        errors: on validation runs.
        clock_shift: between inputs and positions; None where they tell the same time.
    """

    predictions: dict[str, list[np.ndarray]] = field(kw_only=True)
    black_box: list[np.ndarray] = field(kw_only=True)
    localisation: Localisation = field(kw_only=True)
    best: ParameterEstimate = field(kw_only=True)
    errors: Errors = field(kw_only=True)
    clock_shift: ClockShift | None = field(kw_only=True)


@dataclass(frozen=True, eq=False)
class Assessed(Validated):
    """The credibility of every selected effect.

    Attributes:
        judgement: status, probabilities and remarks.
        cause_scores: how far candidates are from being ruled out (`stated_set.score_causes`).
    """

    judgement: Judgement = field(kw_only=True)
    cause_scores: CauseScores = field(kw_only=True)


@dataclass(frozen=True, eq=False)
class Discovery:
    """The verdict, with the data that figures need.

    Attributes:
        verdict: the answer.
        dataset: the data that it is about.
        noise: of the measurements, 1 sigma per axis.
        localisation: where the model misses.
        predictions: modelled points of every run by "nominal", "recalibrated" and "corrected", (rows, points, 3) in m each.
        explanation: all fits.
        law: an invented law, where no known effect explains the gap and a law was asked for.
        seconds: wall time of every stage by its name.
    """

    verdict: Verdict
    dataset: RunSet
    noise: float | np.ndarray
    localisation: Localisation
    predictions: dict[str, list[np.ndarray]]
    explanation: Explanation
    law: Invention | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        """The outcome and the main numbers, in a line."""
        return f"Discovery({self.verdict.status.value}, {shorten(self.dataset.name, 40)}, {len(self.explanation.tried)} fits)"

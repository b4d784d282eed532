"""A model fitted to an earlier recording: what it says of the parameters, and what it misses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.baseline.model_error import ModelError, estimate_model_error
from tepm_opt.discrepancy.baseline.motion_range import share_unlike
from tepm_opt.discrepancy.baseline.settings import DEFAULT, BaselineSettings
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.cross_validation import Evidence, leave_out
from tepm_opt.solvers.identification.identify import ParameterEstimate, Problem, identify
from tepm_opt.solvers.identification.prior import JointPrior


@dataclass(frozen=True, eq=False)
class Baseline:
    """An earlier recording of the same machine.

    Attributes:
        name: of the data set.
        posterior: joint distribution of the known parameters that it tells.
        error: of the model there.
        runs: that the model was fitted to.
    """

    name: str
    posterior: JointPrior
    error: ModelError
    runs: tuple[Run, ...]

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Baseline({self.name}, {self.posterior}, {self.error})"

    @property
    def values(self) -> dict[str, float]:
        """Means of the parameters by full name."""
        return dict(zip(self.posterior.names, self.posterior.mean.tolist(), strict=True))

    def share_unlike(self, runs: Sequence[Run], thresholds: BaselineSettings = DEFAULT) -> float:
        """Share of this recording, or of some runs, with motions that the other has nowhere, 0 … 1."""
        return share_unlike(self.runs, runs, self.error.lasts, thresholds)

    def moves_alike(self, runs: Sequence[Run], thresholds: BaselineSettings = DEFAULT) -> bool:
        """Whether some runs move as this recording does, so that the model's error is the same."""
        return self.share_unlike(runs, thresholds) <= thresholds.max_new_motion

    def constrain(self, problem: Problem) -> Problem:
        """The problem of another recording: with this posterior as prior and this model error as noise."""
        block = problem.block if problem.plant.static else max(problem.block, self.error.lasts)
        return replace(problem, noise=self.error.size, block=block, joint=self.posterior)

    def adapt(self, settings: SearchSettings, runs: Sequence[Run], thresholds: BaselineSettings = DEFAULT) -> SearchSettings:
        """Settings of the search for what changed in some runs.

        The model fits the machine already, so that first order screens candidates that are not smooth, too.
        """
        return replace(
            settings,
            chance_excess=self.error.chance(self.error.count_blocks(runs), thresholds),
            chance_sigmas=thresholds.chance_sigmas,
            max_noise_excess=thresholds.max_noise_excess,
            min_excess_removed=thresholds.min_excess_removed,
            drop_beginnings=False,
            screen_by_fits=False,
        )

    def rebase(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """Candidates that vanish at this recording's values, where they are about parameters that it tells."""
        values = self.values
        return [replace(c, null={name: values.get(name, null) for name, null in c.null.items()}) for c in candidates]

    def as_json(self) -> dict[str, Any]:
        """Posterior and model error as plain data, SI."""
        return {"name": self.name, **self.posterior.as_json(), "model_error": self.error.as_json()}

    @classmethod
    def from_json(cls, content: Mapping[str, Any], runs: Sequence[Run], file: Path) -> Baseline:
        """A baseline that `as_json` wrote.

        Args:
            content: of the file.
            runs: that the model was fitted to.
            file: that it was read from, for messages.

        Raises:
            InputError: something is missing or no valid number.
        """
        posterior, error = JointPrior.from_json(content, file), ModelError.from_json(content.get("model_error"), file)
        return cls(str(content.get("name", file.parent.name)), posterior, error, tuple(runs))


def fit_baseline(name: str, estimate: ParameterEstimate, evidence: Evidence, known: Sequence[str], settings: SearchSettings) -> Baseline:
    """Baseline of a fit without an effect: fitted once more with every point weighed by its own error.

    Args:
        name: of the data set.
        estimate: fit of the known parameters to the recording.
        evidence: of left-out parts of it.
        known: full names of the machine's known parameters.
        settings: of the search.

    Raises:
        InputError: the recording is too short to tell the model's error.
    """
    error = estimate_model_error(estimate, evidence, name)
    problem = estimate.problem
    free = tuple(replace(f, start=float(value)) for f, value in zip(problem.free, estimate.values, strict=True))
    block = problem.block if problem.plant.static else max(problem.block, error.lasts)
    again = identify(replace(problem, noise=error.size, block=block, free=free), settings.max_iterations, tolerance=settings.tolerance)
    error = estimate_model_error(again, leave_out(again, settings), name)
    own = [k for k, f in enumerate(free) if f.name in known]  # not those of effects that gauges show: the other recording has its gauges
    names, units = tuple(free[k].name for k in own), tuple(free[k].unit for k in own)
    posterior = JointPrior(names, again.values[own], again.covariance[np.ix_(own, own)], error.weight, units)
    return Baseline(name, posterior, error, problem.runs)

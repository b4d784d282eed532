"""Thresholds of proposals for the next run."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ExperimentSettings:
    """Thresholds for planned runs.

    Attributes:
        found_sigmas: standard deviations from nothing at which an effect is found; positive.
        apart_sigmas: standard deviations at which a rival is told apart: odds of e^8 on average, and 4 to 1 where chance is against it by
            two sigmas.
        max_hypotheses: hypotheses that a run is asked to tell apart, the best included; at least 2.
    """

    found_sigmas: float = 2.0
    apart_sigmas: float = 4.0
    max_hypotheses: int = 3


DEFAULT = ExperimentSettings()

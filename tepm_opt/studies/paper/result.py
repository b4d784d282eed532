"""Result of an experiment: numbers by key, checks in words, tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False)
class ExperimentResult:
    """Result of an experiment on the rig, beside the model where the paper compares.

    Attributes:
        figure: "fig7", …
        title: for people.
        method: how it was done, in a few sentences.
        numbers: ours by the keys of `published.PUBLISHED`, in their units.
        checks: what the paper says in words, and whether it holds here.
        tables: columns by file name without ending; for the CSV files behind the figure.
        data: whatever the figure needs besides.
    """

    figure: str
    title: str
    method: str
    numbers: Mapping[str, float]
    checks: Mapping[str, bool] = field(default_factory=dict)
    tables: Mapping[str, Mapping[str, np.ndarray]] = field(default_factory=dict)
    data: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        numbers = ", ".join(f"{key}={value:.4g}" for key, value in self.numbers.items())
        return f"ExperimentResult({self.figure}, {sum(self.checks.values())} of {len(self.checks)} checks hold, {numbers})"

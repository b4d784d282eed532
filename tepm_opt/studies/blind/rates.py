"""Rates and means over blind trials, with their intervals; those of other engines."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tepm_opt.discrepancy.assessment.settings import DEFAULT
from tepm_opt.studies.blind.judged import NOTHING, REFUSED, Judged

Z = 1.96
SURE = 0.9  # probability from which a false name is a grave one


@dataclass(frozen=True)
class Rate:
    """Frequency of an event, with Wilson's 95 % interval.

    Attributes:
        name: of the event.
        count, of: how often in how many; nothing is known where `of` is 0.
        least, most: limits that the rate shall keep.
    """

    name: str
    count: int
    of: int
    least: float = 0.0
    most: float = 1.0

    @property
    def value(self) -> float:
        """Rate, NaN of nothing."""
        return self.count / self.of if self.of else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval (Wilson, J. Am. Stat. Assoc. 22, 1927, 209)."""
        return wilson(self.count, self.of)

    @property
    def kept(self) -> bool | None:
        """Whether the limits are kept; None where there are none, or nothing to judge by."""
        if (self.least, self.most) == (0.0, 1.0) or not self.of:
            return None
        return self.least <= self.value <= self.most

    def as_json(self) -> dict[str, Any]:
        """Plain data."""
        numbers = {"rate": self.value, "low": self.interval[0], "high": self.interval[1]}
        limits = {"least": self.least, "most": self.most, "kept": self.kept}
        return {"name": self.name, "count": self.count, "of": self.of, **{key: round_number(at) for key, at in numbers.items()}, **limits}


def wilson(count: int, of: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a rate; NaN of nothing."""
    if not of:
        return float("nan"), float("nan")
    share, spread = count / of, Z**2 / of
    centre, half = (share + spread / 2) / (1 + spread), Z * np.sqrt(share * (1 - share) / of + spread / of / 4) / (1 + spread)
    return max(float(centre - half), 0.0), min(float(centre + half), 1.0)


@dataclass(frozen=True)
class Mean:
    """A mean with its 95 % interval.

    Attributes:
        value, low, high: the mean and its limits.
        of: number of values.
    """

    value: float
    low: float
    high: float
    of: int

    def as_json(self) -> dict[str, Any]:
        """Plain data."""
        return {"mean": round_number(self.value), "low": round_number(self.low), "high": round_number(self.high), "of": self.of}


def count_rate(name: str, judged: Iterable[Judged], so: Callable[[Judged], bool], least: float = 0.0, most: float = 1.0) -> Rate:
    """Frequency of an event over trials.

    Args:
        name: of the event.
        judged: trials.
        so: predicate that is counted.
        least, most: see `Rate`.
    """
    every = [so(each) for each in judged]
    return Rate(name, sum(every), len(every), least, most)


def rate_engine(title: str, judged: Sequence[Judged]) -> list[Rate]:
    """Rates of trials whose robot another engine moves.

    Args:
        title: of the engine.
        judged: its trials.
    """
    known, foreign, null = ([each for each in judged if each.label["kind"] == kind] for kind in ("lib", "foreign", "null"))
    single, several = ([each for each in known if (len(each.causes) > 1) is many] for many in (False, True))
    return [
        count_rate(f"{title}: an alarm where nothing is hidden", null, lambda each: each.status != NOTHING),
        count_rate(f"{title}: detected", [*known, *foreign], is_detected),
        count_rate(f"{title}: right, one effect", single, lambda each: each.right),
        count_rate(f"{title}: right, several effects", several, lambda each: each.right),
        count_rate(f"{title}: right, outside the library", foreign, lambda each: each.right),
        count_rate(f"{title}: a false name above 0.9", judged, lambda each: each.false_above(SURE)),
    ]


def rate_stated_set(judged: Sequence[Judged], least: float) -> Rate:
    """Frequency with which the set of causes that are not ruled out holds all that act.

    Args:
        judged: trials with clear effects of the library; those that calibrated `min_stated` judge nothing.
        least: coverage that is promised.
    """
    scores = [each.least_score for each in judged]
    told = [score >= DEFAULT.min_stated for score in scores if score is not None]
    return Rate("the stated set holds all clear effects", sum(told), len(told), least)


def is_detected(trial: Judged) -> bool:
    """Whether a verdict says that the machine is not the model."""
    return bool(trial.said) or trial.status not in (NOTHING, REFUSED)


def average_probability(judged: Sequence[Judged]) -> Mean | None:
    """Mean probability stated of the true causes, 0 of one that is not listed; None where no trial has a cause with a name."""
    stated = [probability for trial in judged for probability in trial.stated_of_truth]
    if not stated:
        return None
    mean, half = float(np.mean(stated)), Z * float(np.std(stated)) / np.sqrt(len(stated))
    return Mean(mean, max(mean - half, 0.0), min(mean + half, 1.0), len(stated))


def round_number(value: float) -> float | None:
    """Four digits of a number; None where it is none."""
    return float(f"{value:.4g}") if np.isfinite(value) else None

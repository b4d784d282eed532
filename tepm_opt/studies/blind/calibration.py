"""Calibration of stated probabilities and of the stated set, on trials that judge nothing."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.optimize import minimize

from tepm_opt.discrepancy.assessment.calibration import SUREST
from tepm_opt.studies.blind.judged import Judged, join_name

DRAWS = 200  # of the bootstrap
APART = "indistinguishable"  # effects in each other's place share one probability


def fit_calibration(judged: Sequence[Judged], seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Offset and weights of an effect's own and the answer's weakest log odds, (3,), and their 95 % intervals, (2, 3).

    Maximum likelihood of whether each listed effect acts, which is the best mean log score; intervals from trials drawn again.

    Args:
        judged: trials for fitting.
        seed: of the bootstrap.
    """
    by_trial = [rows for each in judged if each.status != APART and (rows := _rows(each))]
    random = np.random.default_rng(seed)
    draws = [random.integers(len(by_trial), size=len(by_trial)) for _ in range(DRAWS)]
    drawn = [_fit([row for number in draw for row in by_trial[number]]) for draw in draws]
    return _fit([row for rows in by_trial for row in rows]), np.percentile(drawn, [2.5, 97.5], axis=0)


def _rows(trial: Judged) -> list[tuple[float, float, float]]:
    """Own and weakest log odds of every effect of an answer, before calibration, and whether it acts (1) or not (-1)."""
    scores = (trial.result["verdict"] or {}).get("scores", {})
    found = np.array([scores.get(join_name(*each.name), each.probability) for each in trial.listed])
    clipped = np.clip(found, SUREST, 1 - SUREST)
    odds = np.log(clipped / (1 - clipped))
    return [(own, odds.min(), 1.0 if each.acts else -1.0) for own, each in zip(odds, trial.listed, strict=True) if each.acts is not None]


def _fit(rows: Sequence[tuple[float, float, float]]) -> np.ndarray:
    """Logistic regression with a slight pull to 0, where all effects act."""
    own, weakest, acts = np.array(rows).T
    terms = np.stack([np.ones_like(own), own, weakest])
    return minimize(lambda weights: np.logaddexp(0, -acts * (weights @ terms)).sum() + 1e-3 * weights @ weights, np.zeros(3)).x


def calibrate_stated_set(judged: Iterable[Judged], coverage: float) -> float:
    """Largest threshold of the scores that promises a coverage; 0 where the trials are too few.

    Split conformal prediction: Vovk, Gammerman, Shafer, Algorithmic Learning in a Random World, 2005, section 2.2.

    Args:
        judged: trials with clear effects of the library.
        coverage: probability that the set holds all that act, on trials of the same kind.
    """
    scores = sorted(each.least_score for each in judged if each.least_score is not None)
    rank = int((1 - coverage) * (len(scores) + 1))
    return scores[rank - 1] if rank else 0.0

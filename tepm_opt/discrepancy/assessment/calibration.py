"""Calibration of stated probabilities: how often what was said so surely was right, in blind trials."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from tepm_opt.discrepancy.assessment.credibility import Judgement
from tepm_opt.discrepancy.assessment.settings import DEFAULT, AssessmentSettings
from tepm_opt.discrepancy.problem.plant import Candidate

SUREST = 1e-4  # distance from 0 and 1 within which probabilities are alike


def calibrate_probability(own: np.ndarray, weakest: np.ndarray, settings: AssessmentSettings = DEFAULT) -> np.ndarray:
    """Frequency with which effects act that were found with some probability, (n,).

    The effects of an answer were fitted together, so that none is much surer than the least sure of them. Platt's logistic
    calibration (Advances in Large Margin Classifiers, 1999, 61) of both log odds.

    Args:
        own: probabilities of the effects, (n,).
        weakest: the smallest probability in the answer of each, (n,).
        settings: coefficients; `tepm_opt.studies.blind.calibration` fits them.
    """
    odds = [np.log(clipped / (1 - clipped)) for clipped in (np.clip(each, SUREST, 1 - SUREST) for each in (own, weakest))]
    return 1 / (1 + np.exp(-(settings.calibration_offset + settings.calibration_own * odds[0] + settings.calibration_weakest * odds[1])))


def calibrate_judgement(judgement: Judgement, shown: Collection[Candidate], settings: AssessmentSettings = DEFAULT) -> Judgement:
    """The judgement with calibrated probabilities; effects in each other's place share theirs as before.

    Args:
        judgement: of the best hypothesis.
        shown: effects that gauges show, which stay certain.
        settings: coefficients.
    """
    total: dict[Candidate, float] = {}
    for effect, _, _, probability in judgement.listed:
        total[effect] = total.get(effect, 0.0) + probability
    if not total:
        return judgement
    found = np.array(list(total.values()))
    stated = calibrate_probability(found, np.full(len(found), found.min()), settings)
    share = {effect: 1.0 if effect in shown else each / was for (effect, was), each in zip(total.items(), stated, strict=True) if was}
    return replace(judgement, listed=tuple((of, effect, fit, p * share.get(of, 1.0)) for of, effect, fit, p in judgement.listed))

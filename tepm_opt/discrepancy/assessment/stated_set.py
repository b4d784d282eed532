"""Set of causes that are not ruled out: it holds what is hidden as often as was promised, on data such as those it was calibrated on."""

from __future__ import annotations

from tepm_opt.discrepancy.assessment.credibility import Judgement
from tepm_opt.discrepancy.assessment.settings import DEFAULT, AssessmentSettings
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.forward_backward import Explanation

CauseScores = tuple[tuple[str, float], ...]
"""Labels of candidates with how far each is from being ruled out, 0 to 1, largest first."""


def score_causes(
    explanation: Explanation, judgement: Judgement, settings: SearchSettings, thresholds: AssessmentSettings = DEFAULT
) -> CauseScores:
    """Score every candidate that was fitted, as conformal prediction needs it (Vovk et al., Algorithmic Learning in a Random World, 2005).

    The score is the largest of: the stated probability; the probability of a rival; the share of the structure left that the candidate
    removes beside the answer, alone or with others. What is no more than noise counts for nothing.

    Args:
        explanation: result of the search.
        judgement: of its best hypothesis.
        settings: of the search.
        thresholds: of the assessment; candidates below `min_scored` are left out.
    """
    found: dict[str, float] = {}

    def add(candidate: Candidate, score: float) -> None:
        found[candidate.label] = max(found.get(candidate.label, 0.0), score)

    for _, candidate, _, probability in judgement.listed:
        add(candidate, probability)
    for effect in explanation.best.effects:
        add(effect, judgement.cause.get(effect, 0.0) * explanation.groups[effect][0][1])
        for hypothesis, weight in explanation.groups[effect][1:]:
            for other in set(hypothesis.effects) - set(explanation.best.effects):
                add(other, weight)
    own = set(explanation.best.effects)
    for hypothesis in explanation.tried:
        if own < set(hypothesis.effects):
            removed = (explanation.best.excess - hypothesis.excess) / (explanation.best.excess + settings.max_noise_excess)
            for other in set(hypothesis.effects) - own:
                add(other, removed)
    ranked = sorted(found.items(), key=lambda each: (-each[1], each[0]))
    return tuple((label, min(score, 1.0)) for label, score in ranked if score >= thresholds.min_scored)


def describe_stated_set(scores: CauseScores, thresholds: AssessmentSettings = DEFAULT) -> str:
    """Sentence with the causes that are not ruled out."""
    stated = [label for label, score in scores if score >= thresholds.min_stated]
    what = f"only {stated[0]}" if len(stated) == 1 else ", ".join(stated) or "no effect of the library"
    return f"Not ruled out: {what}. This list held every acting effect in 95 % of blind trials with clear effects."

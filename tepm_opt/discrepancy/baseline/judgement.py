"""Objections to names for what changed: several causes at once, and motions that the baseline does not have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.assessment.credibility import Judgement
from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.discrepancy.baseline.baseline import Baseline
from tepm_opt.discrepancy.baseline.settings import DEFAULT, BaselineSettings
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.forward_backward import Explanation


def judge_change(
    judgement: Judgement, explanation: Explanation, search: SearchSettings, baseline: Baseline, runs: Sequence[Run],
    settings: BaselineSettings = DEFAULT,
) -> Judgement:  # fmt: skip
    """The judgement of what is missing as one of what changed since a baseline.

    Args:
        judgement: of the effects that were found.
        explanation: result of the search.
        search: its settings.
        baseline: what is compared with.
        runs: of the later recording.
        settings: thresholds.
    """
    found = _doubt_several_causes(judgement, explanation, search, settings)
    best = max((probability for *_, probability in found.listed), default=1.0)
    if best < search.min_listed_probability:
        found = replace(found, status=VerdictStatus.UNEXPLAINED, listed=())
    if baseline.moves_alike(runs, settings):
        return found
    share = 100 * baseline.share_unlike(runs, settings)
    remark = (
        f"{share:.0f} % of the motions of this recording or of {baseline.name} are nowhere in the other one: how much the model errs in "
        "them is unknown, and a change is not told from that. Compare runs with alike inputs."
    )
    if found.status is VerdictStatus.NO_DISCREPANCY:
        return replace(found, remarks=(*found.remarks, remark))
    return Judgement(VerdictStatus.UNEXPLAINED, found.cause, remarks=(*found.remarks, remark))


def _doubt_several_causes(judgement: Judgement, explanation: Explanation, search: SearchSettings, settings: BaselineSettings) -> Judgement:
    """The judgement with lower probabilities of effects that explain the change only together.

    One event lies between two recordings, as a rule: one unknown law is likelier than several known ones at once. An effect that explains
    most of the change alone keeps its probability.
    """
    effects = explanation.best.effects
    if len(effects) < 2:
        return judgement
    alone = {h.effects[0]: explanation.closes(h) for h in explanation.tried if len(h.effects) == 1}
    together = [
        effect for effect in effects if alone.get(effect, 0.0) < settings.min_main_share and effect not in explanation.gauge_effects
    ]
    if not together:
        return judgement
    factor = 1 / (1 + settings.unknown_law_odds * (search.one_cause_odds ** (len(effects) - 1) - 1))
    listed = tuple((of, other, h, p * (factor if of in together else 1.0)) for of, other, h, p in judgement.listed)
    cause = {effect: p * (factor if effect in together else 1.0) for effect, p in judgement.cause.items()}
    remark = (
        f"{' and '.join(effect.full_label for effect in effects)} explain the change only together; "
        "several changes at once are less probable than one that no law of the library describes."
    )
    status = judgement.status
    if status is VerdictStatus.NAMED:
        status = VerdictStatus.PARTIAL
    return replace(judgement, status=status, cause=cause, listed=listed, remarks=(*judgement.remarks, remark))

"""Sentences of an answer about what changed since a baseline."""

from __future__ import annotations

from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.discrepancy.baseline.baseline import Baseline
from tepm_opt.discrepancy.selection.fitting import Hypothesis


def describe_change(
    answer: tuple[str, ...], status: VerdictStatus, baseline: Baseline, without: Hypothesis, moves_alike: bool
) -> tuple[str, ...]:
    """The sentences of an answer with its first one about what changed.

    Args:
        answer: sentences about what is missing in the model.
        status: kind of answer.
        baseline: what it is compared with.
        without: fit of the known parameters within the baseline's posterior.
        moves_alike: whether both recordings have the same kinds of motion.
    """
    since = f"since {baseline.name}"
    if status is VerdictStatus.NO_DISCREPANCY:
        size, chance = without.evidence.without_prior, without.evidence.chance
        more = 100 * (float(size.squares.sum()) / max(size.count, 1) - 1)
        first = (
            f"Nothing changed {since} beyond chance: the parameters stay within what it tells of them, and the model's squared error is "
            f"{more:+.0f} % of what it was there (chance: up to {100 * chance:+.0f} %)."
        )
        if 1 + more / 100 < (1 + chance) ** -2:  # far below what chance makes of it
            return (first, f"The model errs far less than there: something that acted in {baseline.name} may be gone.", *answer[1:])
        return (first, *answer[1:])
    if status is VerdictStatus.UNEXPLAINED and not moves_alike:
        first = f"Not comparable: this recording moves otherwise than {baseline.name}, so that a change is not told from the model's error."
        return (first, *answer[1:])
    heads = {
        VerdictStatus.NAMED: ("Missing: ", f"Changed {since}: "),
        VerdictStatus.PARTIAL: ("Partly explained: ", f"Changed {since}, partly explained: "),
        VerdictStatus.INDISTINGUISHABLE: ("Missing: ", f"Changed {since}: "),
        VerdictStatus.UNEXPLAINED: (
            "Unexplained: structure above the noise remains that no known effect explains",
            f"Unexplained: something changed {since} that no known law explains",
        ),
    }
    before, after = heads.get(status, ("", ""))
    return (answer[0].replace(before, after, 1), *answer[1:]) if before else answer


def describe_model_error(baseline: Baseline, chance: float) -> str:
    """Memory and scatter of the model's error on the baseline, in a sentence; `chance` is the share that its square may differ by."""
    return (
        f"Baseline {baseline.name}: the model's error there lasts {baseline.error.lasts:.2g} s, so that the data are worth "
        f"{baseline.error.blocks} independent pieces; its square may differ by {100 * chance:.0f} % by chance."
    )

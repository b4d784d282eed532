"""Hypotheses that a verdict leaves open, fitted again to its data, for a further run to tell apart."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.discrepancy.assessment.settings import DEFAULT as ASSESSMENT
from tepm_opt.discrepancy.experiments.settings import DEFAULT, ExperimentSettings
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.selection.fitting import Effects, Fits, Hypothesis
from tepm_opt.errors import InputError, unknown_name


def refit_hypotheses(
    content: Mapping[str, Any], corrected: Collection[str], fits: Fits, candidates: Sequence[Candidate],
    settings: ExperimentSettings = DEFAULT,
) -> list[Hypothesis]:  # fmt: skip
    """Fit the best hypothesis of a verdict and those that may be true in its place as the verdict's were, most probable first.

    Where the status is indistinguishable these are its listed effects; otherwise the strongest rivals. Where nothing was named, that
    nothing acts is one of them.

    Args:
        content: of verdict.json.
        corrected: labels of the effects in its model.toml, and names of the values of the robot file that it has changed beyond priors.
        fits: of the data that the verdict is about.
        candidates: effects that may act.
        settings: number of hypotheses.

    Raises:
        InputError: the verdict names an effect that is not known here, or has no rivals.
    """
    try:
        told = [(_candidate(each, candidates, fits), each) for each in content["effects"]]
        status, others = VerdictStatus(content["status"]), [(rival["name"], rival["probability"]) for rival in content["rivals"]]
        known = {name: each["value"] for name, each in content["recalibrated"].items()}
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"verdict.json is damaged: {error}; run tepm discrepancy again") from error
    start = known | {
        f"{c.label}.{name}": value["value"] for c, each in told for name, value in each["parameters"].items() if "." not in name
    }
    start |= {c.detail or "": each["parameters"][c.detail]["value"] for c, each in told if c.detail in each["parameters"]}
    best: Effects = tuple(c for c, _ in told if c.label in corrected or (c.detail or "") in corrected)
    if told and not best:
        best = (told[0][0],)
    sure = {c for c, each in told if each["probability"] >= ASSESSMENT.min_sure}
    rivals = [c for c, _ in told if c not in best]
    if status is not VerdictStatus.INDISTINGUISHABLE or not rivals:
        rivals += [_by_label(name, candidates) for name, _ in others if name not in {c.label for c in (*best, *rivals)}]
        sure = set()
    if not rivals:
        raise InputError(f"verdict {status.value!r} has no rivals: there is nothing to tell apart")
    first = fits.fit(best, start)
    if first is None:
        raise InputError("the model cannot do the runs with the verdict's effects; run tepm discrepancy again")
    found = [first]
    for rival in rivals[: settings.max_hypotheses - 1]:
        places = [effect for effect in best if effect not in sure] or list(best)
        sets = [tuple(c for c in best if c != place) for place in places] or [()]
        trials = [h for rest in sets if (h := _fit_beside(fits, rest, rival, start)) is not None]
        found += [min(trials, key=lambda h: h.estimate.cost)] if trials else []
    if len(found) < 2:
        raise InputError(f"the model cannot do the runs with {', '.join(c.label for c in rivals)}; there is nothing to tell apart")
    return found


def _fit_beside(fits: Fits, rest: Effects, rival: Candidate, start: Mapping[str, float]) -> Hypothesis | None:
    """A rival beside effects: fitted from the values that the verdict has for it, or from those that promise most to first order."""
    if all(name in start for name in rival.parameters):
        return fits.fit((*rest, rival), dict(start))
    base = fits.fit(rest, dict(start))
    if base is None:
        return None
    linear = fits.linear(base, [rival])
    values = linear.gain((*rest, rival))[1] if rival in linear.able else dict(rival.probes[0])
    fits.linearised.clear()  # it holds this rival only
    return fits.fit((*rest, rival), {**base.estimate.named, **values})


def _candidate(each: Mapping[str, Any], candidates: Sequence[Candidate], fits: Fits) -> Candidate:
    """The candidate of an entry, kept to its runs where it acts in some of those fitted to only."""
    label = each["name"] if each["detail"] is None else f"{each['name']}[{each['detail']}]"
    found, stems = _by_label(label, candidates), set(each.get("runs", ()))
    files = [run.file for run in fits.problem.runs]
    own = tuple(file for file in files if Path(file).stem in stems)
    return replace(found, runs=own) if own and len(own) < len(files) else found


def _by_label(label: str, candidates: Sequence[Candidate]) -> Candidate:
    for candidate in candidates:
        if candidate.label == label:
            return candidate
    raise unknown_name("effect", label, [candidate.label for candidate in candidates], "verdict.json")

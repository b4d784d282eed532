"""One blind trial judged: what acts, what was said, what of it is right. Pure functions on a line of `trials.jsonl`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

EVEN = 0.5  # probability from which an effect counts as said
REFUSED = "refused"
NAMED, PARTIAL, NOTHING = "named", "partial", "no_discrepancy"

Name = tuple[str, str | None]
"""An effect and which actuator, point or parameter it is about."""


@dataclass(frozen=True)
class Listed:
    """An effect that a verdict lists, with its stated probability, and whether it acts; None where that cannot be said."""

    name: Name
    probability: float
    acts: bool | None


@dataclass(frozen=True, eq=False)
class Judged:
    """A trial that has its label.

    Attributes:
        result: line of `trials.jsonl`.
    """

    result: Mapping[str, Any]

    @property
    def label(self) -> Mapping[str, Any]:
        """Label of the trial: its hidden causes."""
        return self.result["label"]

    @property
    def family(self) -> str:
        """Family of the trial."""
        return self.result["family"]

    @property
    def causes(self) -> list[Mapping[str, Any]]:
        """Hidden causes."""
        return self.label["causes"]

    @property
    def truth(self) -> set[Name]:
        """Names that the right answer has, with actuator, point or parameter."""
        detail = self.label["detail"]
        return {(name, detail.get(name)) for name in self.label["names"]}

    @property
    def status(self) -> str:
        """Status of the verdict; "refused" where there is none."""
        return self.result["verdict"]["status"] if self.result["verdict"] else REFUSED

    @cached_property
    def listed(self) -> list[Listed]:
        """All effects that the verdict lists."""
        effects = self.result["verdict"]["effects"] if self.result["verdict"] else []
        names = [((each["name"], each["detail"]), float(each["probability"] or 0.0)) for each in effects]
        return [Listed(name, probability, self._acts(name)) for name, probability in names]

    def _acts(self, name: Name) -> bool | None:
        return None if name[0] in self.label["allowed"] else self._stands_for(name) in self.truth

    @property
    def said(self) -> set[Name]:
        """Effects that are listed with at least even odds."""
        return {each.name for each in self.listed if each.probability >= EVEN}

    @property
    def stated_of_truth(self) -> list[float]:
        """Probabilities stated of what should be named, 0 of each that is not listed."""
        stated = {self._stands_for(each.name): each.probability for each in self.listed}
        return [stated.get(name, 0.0) for name in sorted(self.truth, key=str)]

    def false_above(self, probability: float) -> bool:
        """Whether an effect that does not act is listed with more than this probability."""
        return any(each.acts is False and each.probability > probability for each in self.listed)

    @property
    def right(self) -> bool:
        """Whether everything hidden is said with its detail, and nothing else.

        What has no name is right where nothing false is said; nothing hidden where no discrepancy is. A cause of some runs only is
        right as `partial`, too, but only with its runs.
        """
        if self.label["kind"] in ("null", "noise"):
            return self.status == NOTHING
        if not self.truth:
            return self.status != REFUSED and not self.false_above(EVEN)
        said = {self._stands_for(name) for name in self.said if name[0] not in self.label["allowed"]}
        if "runs" in self.label:
            return self.status in (NAMED, PARTIAL) and said == self.truth and self._runs_right
        return self.status == NAMED and said == self.truth

    def _stands_for(self, name: Name) -> Name:
        """Replace a name by that of a hidden cause that looks the same in these runs; else keep it."""
        alike = self.label.get("alike", {})
        return next(((one, name[1]) for one in alike if name[0] in alike[one] and name[1] == self.label["detail"].get(one)), name)

    @property
    def _runs_right(self) -> bool:
        told = [set(each["runs"]) for each in self.result["verdict"]["effects"] if each.get("runs")]
        return told == [set(self.label["runs"])] * len(self.truth)

    @property
    def abstained(self) -> bool:
        """Whether the answer is not right, and says nothing false with at least even odds either."""
        return not self.right and not self.false_above(EVEN)

    def lists_cause(self, cause: Mapping[str, Any]) -> bool:
        """Whether a hidden cause is listed with at least even odds."""
        said = {self._stands_for(name) for name in self.said}
        return all((name, self.label["detail"].get(name)) in said for name in cause["names"])

    def clear(self, misfit: float) -> bool:
        """Whether each cause leaves at least this misfit, over the noise."""
        return all(cause["misfit_over_noise"] >= misfit for cause in self.causes)

    @property
    def least_score(self) -> float | None:
        """Smallest score of a hidden cause among those that are not ruled out: the stated set holds all where it begins below it.

        0 where a cause has none; None without a cause that has a name, or without an answer that has scores.
        """
        scores = (self.result["verdict"] or {}).get("scores")
        if scores is None or not self.truth:
            return None
        stands = {self._stands_for(_parts(label)): score for label, score in reversed(scores.items())}
        return min(stands.get(name, 0.0) for name in self.truth)

    @property
    def closed(self) -> float | None:
        """Part of the gap that recalibration leaves on validation runs and the effects close; None where there is none or no answer."""
        if not self.result["verdict"]:
            return None
        errors = self.result["verdict"]["rmse_m"]
        gap = errors["recalibrated"] - errors["noise_floor"]
        return (errors["recalibrated"] - errors["corrected"]) / gap if gap > 0.1 * errors["noise_floor"] else None

    @property
    def covered(self) -> dict[str, bool]:
        """Whether each true value lies in its 95 % interval: parameters that mean the same, of effects and of the robot."""
        if not self.result["verdict"]:
            return {}
        verdict, found = self.result["verdict"], {}
        stated = {
            f"{join_name(each['name'], each['detail'])}.{name}": value
            for each in verdict["effects"]
            for name, value in each["parameters"].items()
        } | verdict["recalibrated"]
        for name, true in {**self.label["sizes"], **self.label["true_parameters"]}.items():
            value = None if name in self.label.get("other_meaning", ()) else stated.get(name)
            if value and value["std"] is not None and value["value"] is not None:
                found[name] = abs(value["value"] - true) <= 1.96 * value["std"]
        return found


def _parts(label: str) -> Name:
    name, _, detail = label.partition("[")
    return name, detail.removesuffix("]") or None


def join_name(name: str, detail: str | None) -> str:
    """Name of an effect with its detail: "actuator_gain[13]"."""
    return f"{name}[{detail}]" if detail else name

"""Analysis of many blind trials: rates with intervals, detection against size, reliability of probabilities, coverage, confusion."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from tepm_opt.studies.blind.engine import ENGINES
from tepm_opt.studies.blind.judged import EVEN, NAMED, NOTHING, Judged
from tepm_opt.studies.blind.rates import Mean, Rate, average_probability, count_rate, rate_engine, rate_stated_set, round_number, wilson

__all__ = ["Analysis", "Rate", "Reliability", "analyse_results", "confusion", "detection", "rates", "reliability", "wilson"]

CLEAR = 2.0  # times the noise, from which a cause should be named
AS_NOISE = (0.8, 1.25)  # times the noise: what leaves as much as it
EDGES = (0.35, 0.8, 1.25, 2.0, 3.5, 6.0, 11.0, 25.0)  # of the detection curve, times the noise
BINS = 5
DRAWS = 2000  # of the bootstrap
NO_CAUSE = "nothing"  # in the confusion matrix


@dataclass(frozen=True, eq=False)
class Reliability:
    """Stated probabilities against how often what they were stated of acts, in bins of equal count.

    Attributes:
        stated, acts: means of the bins.
        low, high: 95 % band of `acts`, from trials drawn again.
        counts: of the bins.
        error: calibration error: mean distance of the bins, weighted by counts.
        band: 95 % band of the error.
    """

    stated: np.ndarray
    acts: np.ndarray
    low: np.ndarray
    high: np.ndarray
    counts: np.ndarray
    error: float
    band: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Analysis:
    """Summary of all trials.

    Attributes:
        judged: trials with a label.
        failed: messages of those whose data could not be made, with how often.
        rates: in the order of the table.
        detection: by the misfit of single library causes: bin's middle, found, right, all of it.
        truth: by family of another engine, mean probability stated of a cause that it has; none of a family without such trials.
        reliability: of stated probabilities; None where hardly any is stated.
        confusion: by hidden cause, how often what was said.
        closed: parts of the gap closed on validation runs where the answer is right and something is hidden.
        seconds: of the processor for each trial without making it.
    """

    judged: Sequence[Judged]
    failed: Mapping[str, int]
    rates: Sequence[Rate]
    detection: Sequence[tuple[float, Rate, Rate]]
    truth: Mapping[str, Mean]
    reliability: Reliability | None
    confusion: Mapping[str, Mapping[str, int]]
    closed: np.ndarray
    seconds: np.ndarray

    def summary(self) -> dict[str, Any]:
        """Plain data: all numbers."""
        found = self.reliability
        return {
            "trials": len(self.judged),
            "families": dict(sorted(Counter(each.family for each in self.judged).items())),
            "failed": dict(self.failed),
            "rates": [rate.as_json() for rate in self.rates],
            "detection": [
                {"misfit_over_noise": round_number(at), "found": a.as_json(), "right": b.as_json()} for at, a, b in self.detection
            ],
            **{f"probability_of_truth_by_{name}": self.truth[name].as_json() if name in self.truth else None for name in ENGINES},
            "calibration": None
            if found is None
            else {
                "error": round_number(found.error),
                "band": [round_number(value) for value in found.band],
                "stated": [round_number(value) for value in found.stated],
                "acts": [round_number(value) for value in found.acts],
                "counts": found.counts.tolist(),
            },
            "gap_closed": _quantiles(self.closed),
            "seconds": _quantiles(self.seconds),
            "confusion": {cause: dict(said) for cause, said in self.confusion.items()},
        }


def analyse_results(results: Iterable[Mapping[str, Any]]) -> Analysis:
    """Analyse lines of `trials.jsonl`."""
    results = list(results)
    judged = [Judged(each) for each in results if each["label"]]
    failed = Counter(str(each["error"]) for each in results if not each["label"])
    closed = [each.closed for each in judged if each.right and each.truth]
    return Analysis(
        judged,
        dict(failed),
        rates(judged),
        detection(judged),
        {name: mean for name in ENGINES if (mean := average_probability([each for each in judged if each.family == name])) is not None},
        reliability(judged),
        confusion(judged),
        np.array([value for value in closed if value is not None]),
        np.array([each.result["seconds"]["cpu"] - each.result["seconds"]["making"] for each in judged if each.result["seconds"]]),
    )


def rates(judged: Sequence[Judged]) -> list[Rate]:
    """All rates, with their goals."""
    of = {name: [each for each in judged if each.family == name] for name in ("closed", "open", "wrong", "poor", "null", *ENGINES)}
    library = [each for each in of["closed"] if each.causes and each.clear(CLEAR)]
    clear = {k: [each for each in library if len(each.causes) == k] for k in (1, 2, 3, 4)}
    singles = [each for each in of["closed"] if len(each.causes) == 1]
    small = [each for each in singles if AS_NOISE[0] <= each.causes[0]["misfit_over_noise"] <= AS_NOISE[1]]
    intervals = [inside for each in judged if each.right for inside in each.covered.items()]
    effects, robot = ([inside for name, inside in intervals if ("." in name) is dotted] for dotted in (True, False))
    return [
        count_rate("a false name above 0.9", judged, lambda each: each.false_above(0.9), most=0.008),
        count_rate("a false name above 0.5", judged, lambda each: each.false_above(EVEN), most=0.025),
        *(count_rate(f"a false name above 0.5: {name}", some, lambda each: each.false_above(EVEN)) for name, some in of.items()),
        count_rate("right: one effect, clear", clear[1], lambda each: each.right, 0.98),
        count_rate("right: two effects, clear", clear[2], lambda each: each.right, 0.92),
        count_rate("right: three effects, clear", clear[3], lambda each: each.right, 0.85),
        count_rate("right: four effects, clear", clear[4], lambda each: each.right, 0.7),
        count_rate("found: one effect that leaves as much as the noise", small, lambda each: each.lists_cause(each.causes[0]), 0.8),
        count_rate("abstained: effects of the library, clear", library, lambda each: each.abstained, most=0.04),
        count_rate("an alarm where nothing is hidden", of["null"], lambda each: each.status != NOTHING, most=1 / 300),
        count_rate("right: causes outside the library", of["open"], lambda each: each.right),
        *(
            count_rate(f"right: wrong {kind}", [each for each in of["wrong"] if each.label["kind"] == key], lambda each: each.right)
            for kind, key in (("parameter", "prior"), ("declared noise", "noise"), ("clock", "clock"))
        ),
        *(
            count_rate(f"right: poor data, {flaw}", [each for each in of["poor"] if each.label["flaw"] == flaw], lambda each: each.right)
            for flaw in sorted({each.label["flaw"] for each in of["poor"]})
        ),
        *(rate for name, engine in ENGINES.items() for rate in rate_engine(engine.title, of[name])),
        rate_stated_set(library, 0.95),
        Rate("95 % intervals of effects that hold the truth", sum(effects), len(effects), 0.9, 0.98),
        Rate("95 % intervals of the robot's parameters that hold the truth", sum(robot), len(robot), 0.9, 0.98),
    ]


def detection(judged: Sequence[Judged]) -> list[tuple[float, Rate, Rate]]:
    """Single causes of the library by the misfit they leave: geometric mean of a bin, how often found, how often all is right."""
    singles = [each for each in judged if each.family == "closed" and len(each.causes) == 1]
    curve = []
    for low, high in pairwise(EDGES):
        some = [each for each in singles if low <= each.causes[0]["misfit_over_noise"] < high]
        name = f"{low:g} … {high:g}"
        found = count_rate(name, some, lambda each: each.lists_cause(each.causes[0]))
        curve.append((float(np.sqrt(low * high)), found, count_rate(name, some, lambda each: each.right)))
    return curve


def reliability(judged: Sequence[Judged], bins: int = BINS) -> Reliability | None:
    """Calibration of all probabilities stated of listed effects; the band is that of trials drawn again with replacement."""
    told = [(k, each.probability, float(each.acts)) for k, trial in enumerate(judged) for each in trial.listed if each.acts is not None]
    if len(told) < 2 * bins:
        return None
    told.sort(key=lambda each: each[1])
    trial, stated, acts = (np.array(column) for column in zip(*told, strict=True))
    trials, number = np.unique(trial, return_inverse=True)
    random, again, errors = np.random.default_rng(0), [], []
    for _ in range(DRAWS):
        times = np.bincount(random.integers(len(trials), size=len(trials)), minlength=len(trials))
        rows = np.repeat(np.arange(len(told)), times[number])  # still in the order of what is stated
        if len(rows) >= bins:
            found = _average_bins(stated[rows], acts[rows], bins)
            again.append(found[1])
            errors.append(_distance(*found))
    low, high = np.percentile(again, [2.5, 97.5], axis=0)
    least, most = np.percentile(errors, [2.5, 97.5])
    means = _average_bins(stated, acts, bins)
    return Reliability(*means[:2], low, high, means[2], _distance(*means), (float(least), float(most)))


def _average_bins(stated: np.ndarray, acts: np.ndarray, bins: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means and counts of bins of equal count, of what is in the order of `stated`."""
    counts = np.array([len(part) for part in np.array_split(stated, bins)])
    starts = np.append(0, np.cumsum(counts)[:-1])
    return np.add.reduceat(stated, starts) / counts, np.add.reduceat(acts, starts) / counts, counts


def _distance(stated: np.ndarray, acts: np.ndarray, counts: np.ndarray) -> float:
    return float(np.sum(counts * np.abs(stated - acts)) / counts.sum())


def confusion(judged: Sequence[Judged]) -> dict[str, dict[str, int]]:
    """Count the answers (first effect named, or status) by hidden cause, over trials that hide one cause at most."""
    table: dict[str, Counter[str]] = {}
    for each in judged:
        if len(each.causes) > 1:
            continue
        table.setdefault(_hidden(each), Counter())[_answer(each)] += 1
    return {hidden: dict(table[hidden].most_common()) for hidden in sorted(table)}


def _hidden(each: Judged) -> str:
    """Name the only hidden cause; its form stands in brackets where it is not the usual one."""
    if not each.causes:
        return NO_CAUSE
    key, names = each.causes[0]["cause"], each.causes[0]["names"]
    if each.label["kind"] == "prior":
        return f"{names[0]}[{key}]"
    return f"{names[0]} ({key})" if names and names[0] != key else key


def _answer(each: Judged) -> str:
    """The most probable name, or the status where none is said; a right name with a wrong detail says so."""
    if each.status in (NAMED, "partial", "indistinguishable") and each.said:
        first = max((one for one in each.listed if one.name in each.said), key=lambda one: one.probability).name
        wrong = first not in each.truth and first[0] in {name for name, _ in each.truth}
        if first[0] == "parameter" and first[1]:
            return f"parameter[{first[1]}]"
        return f"{first[0]} elsewhere" if wrong else first[0]
    return each.status


def _quantiles(values: np.ndarray) -> dict[str, float | None]:
    if not len(values):
        return {}
    at = (("median", 50), ("low", 5), ("high", 95), ("largest", 100))
    return {name: round_number(float(np.percentile(values, part))) for name, part in at}

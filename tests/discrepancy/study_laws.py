"""How well unknown laws are found: `python -m tests.discrepancy.study_laws FOLDER [KEY …]` prints a line for each trial of `laws`.

The search for names is left out: what recalibration leaves is what the law is sought in, as if no name had been found.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from tepm_opt.data.datasets import read_dataset
from tepm_opt.discrepancy.freeform.formula import named
from tepm_opt.discrepancy.freeform.invent import Invention, invent
from tepm_opt.discrepancy.freeform.terms import Terms
from tepm_opt.discrepancy.freeform.writing import curve
from tepm_opt.errors import InputError
from tepm_opt.models.compile import compile_model
from tepm_opt.models.effect_files import unload_effect
from tepm_opt.models.model import Model
from tepm_opt.solvers.identify import Problem, identify
from tepm_opt.solvers.network_plant import NetworkPlant
from tests.discrepancy.hidden import make
from tests.discrepancy.laws import TRIALS, Trial

COEFFICIENTS = 0.2  # relative, by which those of the right formula may be off


@dataclass(frozen=True)
class Found:
    """What was found in a trial, and how it compares with the truth; None where that cannot be said."""

    key: str
    law: str = ""
    formula: str = ""
    place: bool = False
    gap_closed: float | None = None
    curve: float | None = None
    terms: bool | None = None
    beyond: int = 0
    seconds: float = 0.0


def examined(trial: Trial, folder: Path, out: Path) -> Found:
    """One trial, from its data on."""
    key, began = trial.hidden.key, time.monotonic()
    data = read_dataset(folder / key)
    known = Model.of(data.robot)
    plant = NetworkPlant(compile_model(known))
    noise = data.position_noise or trial.hidden.noise
    problem = Problem(plant, data.fit, plant.free(tuple(known.robot.priors)), noise, step=0.02, derivatives_apart=0.04)
    judged = [run for run in data.runs if run.role == "validation"]
    found = invent(identify(problem), known, out / key, key, judged)
    if found is None:
        return Found(key, place=not trial.place, seconds=time.monotonic() - began)
    place = found.formula.place
    right = (place.kind, place.target in trial.targets, place.of in trial.variables) == (trial.place, True, True)
    floor = noise * np.sqrt(3)
    closed = (found.errors[0] - found.errors[1]) / (found.errors[0] - floor)
    terms = [named(place, k) for k in found.formula.chosen]
    unload_effect(found.written.name)
    values = {name: float(f"{value:.4g}") for name, value in found.estimate.named.items() if "." in name}
    return Found(
        key,
        found.written.name,
        json.dumps(values),
        right,
        float(closed),
        _curve(trial, found) if right else None,
        _terms(trial, found, terms) if right else None,
        len(found.beyond),
        time.monotonic() - began,
    )


def _curve(trial: Trial, found: Invention) -> float | None:
    """Root mean square error of the curve over the truth's, without a straight line where recalibration takes one up."""
    place = found.formula.place
    if trial.curve is None or not isinstance(place.shape, Terms):
        return None
    low, high = min(found.scored.place.shape.knots), max(found.scored.place.shape.knots)  # type: ignore[attr-defined]
    values = np.linspace(low, high, 200)
    line = np.stack([np.ones_like(values), values], axis=1)

    def bent(law: np.ndarray) -> np.ndarray:
        return law - line @ np.linalg.lstsq(line, law, rcond=None)[0] if place.target == "all" else law

    truth = trial.curve(values)
    return float(np.sqrt(np.mean(bent(curve(found.fitted_formula, values) - truth) ** 2)) / np.sqrt(np.mean(truth**2)))


def _terms(trial: Trial, found: Invention, terms: list[str]) -> bool | None:
    """Whether the formula has the right terms, and coefficients within a fifth where they are known."""
    if not trial.terms:
        return None
    if sorted({term.split(": ")[-1] for term in terms}) != sorted(trial.terms):
        return False
    shape, formula = found.formula.place.shape, found.fitted_formula
    powers = {"constant": 0, "linear": 1, "quadratic": 2, "cubic": 3, "ramp": 1}
    for term, coefficient in zip(terms, formula.coefficients, strict=True):
        truth = trial.terms.get(term, 0.0)
        if truth and term in powers and isinstance(shape, Terms):
            value = coefficient / shape.reference ** powers[term]
        elif truth and term == "lag":
            value = found.estimate.named[f"{found.written.name}.time"]
        else:
            continue
        if abs(value - truth) > COEFFICIENTS * abs(truth):
            return False
    return True


def main() -> None:
    """Print a line for every trial; write what was found to FOLDER/found.json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("keys", nargs="*", help="only these")
    parser.add_argument("--short", action="store_true", help="runs of 6 to 8 s instead of 20 to 25 s")
    options = parser.parse_args()
    found: list[dict[str, Any]] = []
    for trial in TRIALS:
        key = trial.hidden.key
        if options.keys and key not in options.keys:
            continue
        try:
            if not (options.folder / key / "dataset.toml").exists():
                make(trial.hidden, options.folder / key, options.short)
            result = examined(trial, options.folder, options.folder / "laws")
        except (InputError, ValidationError) as error:
            result = Found(key, law=f"not made: {str(error).splitlines()[0]}"[:120])
        found.append(asdict(result))
        print("ok   " if result.place else "MISS ", result, flush=True)
        (options.folder / "found.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

"""How well unknown laws are found: `python -m tests.discrepancy.study_laws FOLDER [KEY …]` prints a line for each trial of `laws`.

The search for names is left out: what recalibration leaves is what the law is sought in, as if no name had been found. Besides the runs
to judge by there are some that push and pull harder (`far`); in which of them a law's variable leaves what the machine went through in the
runs fitted to, the machine's own positions and lengths say, which nobody measures.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from tepm_opt.data.datasets import read_dataset
from tepm_opt.data.run import Run
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.discrepancy.symbolic.formula import name_term
from tepm_opt.discrepancy.symbolic.invent import Invention, error_on, invent
from tepm_opt.discrepancy.symbolic.places import Course
from tepm_opt.discrepancy.symbolic.settings import DEFAULT
from tepm_opt.discrepancy.symbolic.terms import Terms
from tepm_opt.discrepancy.symbolic.writing import curve
from tepm_opt.errors import InputError
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.models.compile import compile_model
from tepm_opt.models.effect_files import unload_effect
from tepm_opt.models.model import Model
from tepm_opt.solvers.identification.identify import Problem, identify
from tepm_opt.solvers.mechanics.network_plant import NetworkPlant
from tepm_opt.studies.blind import machine
from tepm_opt.studies.blind.excitation import Excitation, excitations
from tepm_opt.studies.blind.machine import Deviation
from tests.discrepancy.hidden import ROBOT, make, played, true_factors
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
    left: int = 0
    left_flagged: int = 0
    stayed: int = 0
    stayed_flagged: int = 0
    seconds: float = 0.0


def examined(trial: Trial, folder: Path, out: Path, short: bool) -> Found:
    """One trial, from its data on."""
    key, began = trial.hidden.key, time.monotonic()
    data = read_dataset(folder / key)
    known = Model.from_robot(data.robot)
    plant = NetworkPlant(compile_model(known))
    noise = data.position_noise or trial.hidden.noise
    problem = Problem(plant, data.fit, plant.free(tuple(known.robot.priors)), noise, step=0.02, derivatives_apart=0.04)
    judged = [run for run in data.runs if run.role == "validation"]
    further = [played(trial.hidden, run) for run in far(excitations(trial.hidden.seed, short))]
    before = identify(problem)
    found = invent(before, known, out / key, key, [*judged, *further])
    if found is None:
        return Found(key, place=not trial.place, seconds=time.monotonic() - began)
    place = found.formula.place
    right = (place.kind, place.target in trial.targets, place.of in trial.variables) == (trial.place, True, True)
    floor = noise * np.sqrt(3)
    without, corrected = (error_on(estimate, judged) for estimate in (before, found.estimate))
    closed = (without - corrected) / (without - floor)
    terms = [name_term(place, k) for k in found.formula.chosen]
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
        *flags(trial, found, short),
        time.monotonic() - began,
    )


def far(runs: Sequence[Excitation]) -> list[Excitation]:
    """The last run with other sizes: weaker, with higher pressures, with higher tensions, with a force on the tip."""
    found, (run, asked) = [], (runs[-1], runs[-1].setpoints)
    for name, pressure, tension, force in (
        ("weak", 0.7, 0.7, 0.0),
        ("high", 1.3, 1.0, 0.0),
        ("tight", 1.0, 2.5, 0.0),
        ("pushed", 1, 1, 0.6),
    ):
        inputs = np.hstack([asked.inputs[:, :6] * pressure, asked.inputs[:, 6:] * tension])
        pushed = asked.tip_force + force * np.sin(np.linspace(0, np.pi, len(inputs)))[:, None] * [[1, 0, 0]]
        found.append(replace(run, file=f"{name}.csv", setpoints=SetPoints(asked.time, inputs, pushed)))
    return found


def flags(trial: Trial, found: Invention, short: bool) -> tuple[int, int, int, int]:
    """How many runs to judge by leave what the machine went through, how many of these are told; how many stay within, and are told."""
    runs = excitations(trial.hidden.seed, short)
    place, layout = found.formula.place, found.estimate.plant.model.layout  # type: ignore[union-attr]
    constant = all(name_term(place, k).endswith("constant") for k in found.formula.chosen)
    variables = () if constant else tuple(filter(None, (place.variable, place.times)))
    went = {run.file: went_through(trial, run) for run in (*runs, *far(runs))}
    fitted = [went[run.file] for run in runs if run.role == "fit"]
    told, count = {run.file for run in found.beyond}, [0, 0, 0, 0]
    for run in (*(run for run in runs if run.role == "validation"), *far(runs)):
        leaves = False
        for variable in variables:
            among, here = (
                [(v if variable == "time" else v[:, place.targets(layout)]) for v in (c.values_of(variable) for c in some)]
                for some in (fitted, [went[run.file]])
            )
            low, high = min(v.min() for v in among), max(v.max() for v in among)
            room = DEFAULT.range_margin * (high - low)
            leaves |= bool(here[0].min() < low - room or here[0].max() > high + room)
        count[0 if leaves else 2] += 1
        count[1 if leaves else 3] += run.file in told
    return count[0], count[1], count[2], count[3]


def went_through(trial: Trial, run: Excitation) -> Course:
    """What the machine itself went through in a run, without noise: commands, its positions and its lengths."""
    hidden = Deviation(trial.hidden.imperfections, true_factors(trial.hidden), trial.hidden.before)
    rig = SimulatedRig(machine.rig_file(ROBOT, hidden, 0.0, trial.hidden.seed))
    rig.reseed(0, run.began)
    rig.schedule(run.setpoints if hidden.before is None else hidden.before(run.setpoints))
    states = []
    for _ in run.setpoints.time:
        rig.read()
        states.append((rig.true_points, rig.true_lengths))
    asked = run.setpoints
    points, lengths = (np.array(values) for values in zip(*states, strict=True))
    whole = Run(run.file, run.role, asked.time, asked.inputs, asked.tip_force, points, began=run.began)
    return Course(compile_model(Model.from_robot(ROBOT)), whole, points, lengths)


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
            result = examined(trial, options.folder, options.folder / "laws", options.short)
        except (InputError, ValidationError) as error:
            result = Found(key, law=f"not made: {str(error).splitlines()[0]}"[:120])
        found.append(asdict(result))
        print("ok   " if result.place else "MISS ", result, flush=True)
        (options.folder / "found.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

"""Blind trials: a data set in which something is hidden, drawn from a seed and a number."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from tepm_opt.data.datasets import DataSet, write_dataset
from tepm_opt.data.run import Run
from tepm_opt.errors import unknown_name
from tepm_opt.models.channels import channels_of
from tepm_opt.models.effects import effects
from tepm_opt.models.robot import Robot, load_robot
from tepm_opt.studies.blind.causes import LIBRARY, Cause
from tepm_opt.studies.blind.engine import ENGINES
from tepm_opt.studies.blind.excitation import RATE, draw_runs, thin_run
from tepm_opt.studies.blind.flaws import CLOCKS, POOR, Flaw, add_feedback, mistaken, spoil_run
from tepm_opt.studies.blind.foreign import FOREIGN
from tepm_opt.studies.blind.hidden import Experiment, Hidden, describe
from tepm_opt.studies.blind.machine import Deviation, combine_deviations, rig_file, simulate_run
from tepm_opt.studies.blind.sizes import UNBEARABLE, Pilot

Family = Literal["closed", "open", "wrong", "poor", "null", "engine", "rod"]
FAMILIES: tuple[Family, ...] = get_args(Family)
CYCLE: tuple[Family, ...] = tuple(next(one for one in FAMILIES if one[0] == letter) for letter in "cnocwcnpocncowpn")
"""Families of trials, by their number, where all are wanted: of 16 five closed, four null, three open, two wrong and two poor.

Neither `engine` nor `rod` is among them: they take a minute and more a trial and are only made where they are asked for.
"""

NOISE = (1.5e-4, 6e-4)  # m per axis
MISFIT = (0.5, 20.0)  # times the noise, of each cause
CLEAR = 2.0  # times the noise, from which a cause should be named
MANY = (0.5, 0.25, 0.17, 0.08)  # how often one to four causes act at once
CLEARLY = 0.75  # how often causes that act together all are clear
PARTS_WRONG = (0.55, 0.25)  # of the wrong ones: parameters, clocks; the rest have another noise than declared
NOISIER = (0.03, 0.5)  # by how much
NOTHING = 0.25  # of poor data hide nothing
PASSES = 3  # until feedback and motion agree
TRIES = 8  # draws until a machine bears what is drawn


@dataclass(frozen=True)
class Trial:
    """Identity of a trial: everything in it is drawn from these.

    Attributes:
        seed: of all trials.
        number: of this one, from 0.
        family: what kind of thing is hidden.
    """

    seed: int
    number: int
    family: Family

    @staticmethod
    def from_number(seed: int, number: int, family: str | None = None) -> Trial:
        """Make a trial of a family, or of the one whose turn it is.

        Raises:
            InputError: no such family.
        """
        if family is not None and family not in FAMILIES:
            raise unknown_name("family", family, FAMILIES)
        return Trial(seed, number, next(one for one in FAMILIES if one == (family or CYCLE[number % len(CYCLE)])))

    @property
    def random(self) -> np.random.Generator:
        """Generator of random numbers that everything in the trial is drawn from."""
        return np.random.default_rng([self.seed, self.number, zlib.crc32(self.family.encode())])


@dataclass(frozen=True)
class TrialSeries:
    """Trials by their numbers; each depends on the seed, its number and its family alone.

    Attributes:
        count: how many.
        seed: of all.
        family: that all are of; None for all families in turn.
    """

    count: int
    seed: int = 0
    family: str | None = None

    @property
    def trials(self) -> list[Trial]:
        """All trials, by number.

        Raises:
            InputError: no such family.
        """
        return [Trial.from_number(self.seed, number, self.family) for number in range(self.count)]


@dataclass(frozen=True, eq=False)
class Made:
    """A trial's data set, and what is hidden in it (plain data)."""

    dataset: DataSet
    label: dict[str, Any]

    def write(self, folder: Path, name: str) -> None:
        """Write the data set to FOLDER/NAME, which says nothing of what is hidden, and that to FOLDER/labels/NAME.json."""
        write_dataset(self.dataset, folder / name, overwrite=True)
        (folder / "labels").mkdir(exist_ok=True)
        (folder / "labels" / f"{name}.json").write_text(json.dumps(self.label, indent=1) + "\n", encoding="utf-8")


@cache
def _robot() -> Robot:
    return load_robot("kang2017")


def make(trial: Trial) -> Made:
    """The data set of a trial: the same whenever and wherever it is made."""
    random = trial.random
    return _record_machine(trial, random, DRAW[trial.family](random))


def _draw_engine(family: str) -> Callable[[np.random.Generator], Experiment]:
    return lambda random: ENGINES[family].draw_experiment(random, lambda seconds: _pilot(random, Flaw(seconds)))


def _pilot(random: np.random.Generator, flaw: Flaw | None = None) -> Pilot:
    """A machine within its priors, noise, and runs that the machine bears."""
    flaw = flaw or Flaw()
    noise = float(np.exp(random.uniform(*np.log(NOISE))))
    machine = Deviation(factors={name: 1 + float(random.uniform(-width, width)) for name, width in sorted(_robot().priors.items())})
    for _ in range(TRIES):
        runs = [thin_run(run, flaw.every) for run in draw_runs(random, *flaw.seconds, flaw.fit, flaw.judges)]
        try:
            return Pilot.from_simulation(_robot(), machine, runs, noise, RATE / flaw.every)
        except UNBEARABLE:
            continue
    raise RuntimeError(f"a machine does not bear any of {TRIES} draws of inputs")


def _hidden(random: np.random.Generator, pilot: Pilot, table: Mapping[str, Cause], wanted: Sequence[float]) -> tuple[Hidden, ...]:
    """Different causes with about these misfits; others where the machine does not bear one, or its limits do not let it matter.

    Args:
        random: what is drawn from.
        pilot: of the machine without them.
        table: causes to draw from.
        wanted: misfits over the noise.
    """
    found: list[Hidden] = []
    for key in random.permutation(sorted(table)):
        if len(found) == len(wanted):
            break
        form = table[str(key)](random)
        size, misfit = pilot.find_size(form, wanted[len(found)])
        if misfit >= 0.7 * MISFIT[0]:
            found.append(Hidden(str(key), form, size, misfit))
    return tuple(found)


def _misfits(random: np.random.Generator, count: int, low: float = MISFIT[0]) -> list[float]:
    return np.exp(random.uniform(np.log(low), np.log(MISFIT[1]), count)).tolist()


def _draw_closed(random: np.random.Generator) -> Experiment:
    pilot, count = _pilot(random), 1 + int(random.choice(len(MANY), p=MANY))
    low = CLEAR if count > 1 and random.uniform() < CLEARLY else MISFIT[0]
    return Experiment(pilot, "lib", _hidden(random, pilot, LIBRARY, _misfits(random, count, low)))


def _draw_open(random: np.random.Generator) -> Experiment:
    pilot = _pilot(random)
    return Experiment(pilot, "foreign", _hidden(random, pilot, FOREIGN, _misfits(random, 1)))


def _draw_wrong(random: np.random.Generator) -> Experiment:
    pilot, drawn = _pilot(random), random.uniform()
    if drawn < PARTS_WRONG[0]:
        return Experiment(pilot, "prior", _hidden(random, pilot, mistaken(pilot.robot), _misfits(random, 1)))
    if drawn < sum(PARTS_WRONG):
        return Experiment(pilot, "clock", _hidden(random, pilot, CLOCKS, _misfits(random, 1)))
    return Experiment(pilot, "noise", declared=float((1 + np.exp(random.uniform(*np.log(NOISIER)))) ** random.choice([-1, 1])))


def _draw_poor(random: np.random.Generator) -> Experiment:
    key = str(random.choice(sorted(POOR)))
    flaw = POOR[key]
    pilot = _pilot(random, flaw)
    going_on = {effect.name for effect in effects() if effect.timed}  # in a session's time, and not in some runs only
    table = {name: cause for name, cause in LIBRARY.items() if not (flaw.partly and name in going_on)}
    causes = () if random.uniform() < NOTHING and not flaw.partly else _hidden(random, pilot, table, _misfits(random, 1))
    return Experiment(pilot, "lib" if causes else "null", causes, flaw, key)


DRAW: dict[Family, Callable[[np.random.Generator], Experiment]] = {
    "closed": _draw_closed,
    "open": _draw_open,
    "wrong": _draw_wrong,
    "poor": _draw_poor,
    "null": lambda random: Experiment(_pilot(random), "null"),
    "engine": _draw_engine("engine"),
    "rod": _draw_engine("rod"),
}


def _record_machine(trial: Trial, random: np.random.Generator, experiment: Experiment) -> Made:
    """The runs of the machine with its causes, fewer where it does not bear all at once."""
    pilot, flaw = experiment.pilot, experiment.flaw
    acting = _draw_acting_runs(random, len(pilot.runs)) if flaw.partly else np.ones(len(pilot.runs), dtype=bool)
    while True:
        machine = combine_deviations([pilot.machine, *(cause.form.at(cause.size) for cause in experiment.causes)])
        try:
            runs = [_record_run(trial, experiment, number, machine if acts else pilot.machine) for number, acts in enumerate(acting)]
            break
        except UNBEARABLE:
            if not experiment.causes:
                raise
            experiment = replace(experiment, causes=experiment.causes[:-1])
    runs = tuple(spoil_run(run, flaw, random, pilot.noise) for run in runs)
    dataset = DataSet("experiment", pilot.robot.name, channels_of(pilot.robot), runs, pilot.rate, pilot.noise * experiment.declared)
    return Made(dataset, describe(experiment, machine, acting))


def _draw_acting_runs(random: np.random.Generator, runs: int) -> np.ndarray:
    """Draw the runs, (runs,) of bool, in which a cause acts that comes or goes during the session."""
    first = int(random.integers(2, 4))  # at least two runs to fit to with it, and two without
    return (np.arange(runs) >= first) == (random.uniform() < 0.5)


def _record_run(trial: Trial, experiment: Experiment, number: int, machine: Deviation) -> Run:
    """Record a run of a machine, with the feedback of a controller where there is one.

    Args:
        trial: which.
        experiment: its.
        number: of the run.
        machine: what differs from the robot file.
    """
    if trial.family in ENGINES:
        return ENGINES[trial.family].record_run(experiment.pilot, machine, experiment.pilot.runs[number], f"{trial} {number}")
    pilot, noise = experiment.pilot, zlib.crc32(f"{trial} {number}".encode())
    file, planned = rig_file(pilot.robot, machine, pilot.noise, trial.number, pilot.rate), pilot.runs[number]
    run = simulate_run(file, machine, planned, noise)
    if experiment.flaw.loop:
        goal = simulate_run(rig_file(pilot.robot, pilot.machine, 0.0, rate=pilot.rate), pilot.machine, planned, 0).points
        for _ in range(PASSES):  # what is measured and what is commanded agree more and more
            run = simulate_run(file, machine, replace(planned, setpoints=add_feedback(planned.setpoints, run.points, goal)), noise)
    return run

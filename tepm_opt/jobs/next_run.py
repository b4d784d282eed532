"""The run that best tells apart what a verdict leaves standing."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.datasets import DataSet
from tepm_opt.data.files import output_folder, write_atomically
from tepm_opt.data.noise import noise_of
from tepm_opt.discrepancy.adapters.network import SearchableNetwork
from tepm_opt.discrepancy.experiments.hypotheses import refit_hypotheses
from tepm_opt.discrepancy.experiments.separation import separation
from tepm_opt.discrepancy.problem.plant import without_run_restriction
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.fitting import Fits, Hypothesis, labels
from tepm_opt.errors import InputError
from tepm_opt.hw.commands import check_setpoints
from tepm_opt.jobs.discrepancy import MODEL, VERDICT, checked_datasets, read_verdict
from tepm_opt.models.channels import channels_of
from tepm_opt.models.compile import compile_model
from tepm_opt.models.model import Model, read_model
from tepm_opt.models.robot import builtin_robots
from tepm_opt.progress import Progress, silent
from tepm_opt.recording.patterns import Pattern, PatternContext
from tepm_opt.recording.plan import PlannedRun
from tepm_opt.recording.probing import draw_pattern, random_run, vary_pattern
from tepm_opt.recording.reach import Reach, reach_of, unbearable
from tepm_opt.recording.standard import PlannedPattern, plan_text
from tepm_opt.solvers.identification.identify import ParameterEstimate, Problem
from tepm_opt.solvers.mechanics.network_plant import NetworkPlant
from tepm_opt.solvers.mechanics.plant import PredictionError
from tepm_opt.solvers.mechanics.predict import LONGEST_STEP

DRAWS, ROUNDS, KEPT, NEAR = 20, 2, 2, 4
"""Runs that are drawn; rounds of variation after them, the best runs that are varied in each, and how often."""
TRIES = 20  # draws until a robot bears a random run
FARTHEST, ROUGH = 0.7, 0.25
"""Limits of the tip's way from a run's start, over the arm's length, and of the effect of the fits' time step on a run, over the noise."""
LEAST = 0.1  # standard deviations below which nothing is told apart
SHORTEST, LONGEST = 5.0, 600.0  # s


@dataclass(frozen=True, eq=False)
class Proposal:
    """A run that may be made, and how far apart it keeps hypotheses in standard deviations."""

    pattern: Pattern
    planned: PlannedRun
    sigmas: float

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Proposal({self.planned!r}, {self.sigmas:.3g} sigmas)"

    @property
    def log_odds(self) -> float:
        """The mean change of the logarithm of the odds of two hypotheses."""
        return self.sigmas**2 / 2


@dataclass(frozen=True, eq=False)
class Rig:
    """Robot and sensors that runs are proposed for.

    Attributes:
        model: of the robot as it is known, for its levels.
        reach: levels and sway.
        rate: of the samples in Hz.
        noise: of a coordinate, 1 sigma in m.
        seconds: length of a run.
        loads: whether a known force may act on the tip.
    """

    model: Model
    reach: Reach
    rate: float
    noise: float
    seconds: float
    loads: bool = True

    def plan_run(self, pattern: Pattern) -> PlannedRun:
        """Work out the set points of a pattern.

        Raises:
            InputError: beyond the robot's limits.
        """
        setup = PatternContext(self.model.robot, self.rate, Path(), pattern.file)
        setpoints = pattern.setpoints(setup)
        check_setpoints(setpoints, self.model.robot)
        return PlannedRun(pattern.file, pattern.role, setpoints)

    def proposal(self, pattern: Pattern | None, estimates: Sequence[ParameterEstimate]) -> Proposal | None:
        """A pattern with its separation; None where it is beyond the limits, or much longer or shorter than wanted."""
        if pattern is None:
            return None
        try:
            planned = self.plan_run(pattern)
        except InputError:
            return None
        if abs(planned.setpoints.time[-1] - self.seconds) > 0.05 * self.seconds:
            return None
        run = planned.sample_at(self.rate, len(channels_of(self.model.robot).points))
        return Proposal(pattern, planned, separation(estimates, run, self.noise))

    def bears(self, proposal: Proposal, estimates: Sequence[ParameterEstimate]) -> bool:
        """Whether the machine stands under all set points and swings no farther than models are trusted, whichever hypothesis is true."""
        robot, run = self.model.robot, proposal.planned.sample_at(self.rate, len(channels_of(self.model.robot).points))
        farthest = FARTHEST * robot.modules * robot.parameters.L_0
        for plant in (without_run_restriction(estimate.plant) for estimate in estimates):
            if isinstance(plant, NetworkPlant) and unbearable(plant.model, proposal.planned.setpoints, motion=False):
                return False
            try:
                coarse, fine = (plant.predict(run, (), step).points for step in (LONGEST_STEP, SearchSettings().final_step))
            except PredictionError:
                return False
            if np.linalg.norm(fine[:, -1] - fine[0, -1], axis=1).max() > farthest:
                return False
            if np.sqrt(np.mean((coarse - fine) ** 2)) > ROUGH * self.noise:
                return False
        return True


def best_run(rig: Rig, estimates: Sequence[ParameterEstimate], seed: int, progress: Progress = silent) -> Proposal:
    """The run that keeps some fitted hypotheses farthest apart, of runs that are drawn and varied.

    Args:
        rig: what it is for.
        estimates: of the hypotheses.
        seed: of what is drawn.
        progress: told of every run tried.

    Raises:
        InputError: no run that the robot bears separates the hypotheses.
    """
    random = np.random.default_rng([seed, 1])
    total = DRAWS + 1 + ROUNDS * KEPT * NEAR
    by_chance = any_run(rig, estimates, seed)
    tried = [] if by_chance is None else [by_chance]

    def look(make: Callable[[], Pattern | None], times: int) -> None:
        for _ in range(times):
            progress("trying runs", len(tried), total)
            found = rig.proposal(make(), estimates)
            tried.extend([found] if found else [])

    look(lambda: draw_pattern(random, rig.model.robot, rig.reach, rig.seconds, rig.loads), DRAWS)
    for _ in range(ROUNDS):
        tried.sort(key=lambda each: -each.sigmas)
        for each in list(islice((each for each in tried if rig.bears(each, estimates)), KEPT)):
            look(lambda each=each: vary_pattern(random, each.pattern), NEAR)
    for each in sorted(tried, key=lambda each: -each.sigmas):
        if each.sigmas > LEAST and rig.bears(each, estimates):
            return each
    few = f"none of {len(tried)} runs of {rig.seconds:g} s"
    raise InputError(f"robot {rig.model.robot.name}: {few} tells the hypotheses apart and is borne; try other --seconds or another --seed")


def any_run(rig: Rig, estimates: Sequence[ParameterEstimate], seed: int) -> Proposal | None:
    """A random run of the same length, for comparison; None where the machine bears none of those drawn.

    Args:
        rig: what it is for.
        estimates: of the hypotheses.
        seed: of what is drawn.
    """
    random = np.random.default_rng([seed, 2])
    for _ in range(TRIES):
        found = rig.proposal(random_run(random, rig.reach, rig.seconds), estimates)
        if found and found.sigmas > LEAST and rig.bears(found, estimates):
            return found
    return None


@dataclass(frozen=True, eq=False)
class NextRun:
    """The run that is proposed.

    Attributes:
        hypotheses: that it tells apart, most probable first.
        best: the proposal.
        random: a random run of the same length.
        rig: what it is for.
        dataset: that the verdict is about.
    """

    hypotheses: tuple[Hypothesis, ...]
    best: Proposal
    random: Proposal | None
    rig: Rig
    dataset: DataSet

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"NextRun({', '.join(map(labels, self.hypotheses))}: {self.best!r})"

    def summary(self) -> dict[str, Any]:
        """Summarize the hypotheses told apart and how well, as plain data."""
        return {
            "hypotheses": [[effect.full_label for effect in hypothesis.effects] for hypothesis in self.hypotheses],
            "pattern": self.best.pattern.pattern,  # type: ignore[attr-defined]
            "seconds": round(float(self.best.planned.setpoints.time[-1]), 3),
            "sigmas": float(f"{self.best.sigmas:.4g}"),
            "log_odds": float(f"{self.best.log_odds:.4g}"),
            "random_run": None
            if self.random is None
            else {"sigmas": float(f"{self.random.sigmas:.4g}"), "log_odds": float(f"{self.random.log_odds:.4g}")},
        }

    def save(self, path: str | Path) -> None:
        """Write the plan file for `tepm record`.

        Raises:
            InputError: the folder cannot be written to.
        """
        path = Path(path)
        folder, source = output_folder(path.parent), self.rig.model.source
        robot = source if source in builtin_robots() else Path(os.path.relpath(source, folder)).as_posix()
        told = " or ".join(" + ".join(e.full_label for e in h.effects) or "nothing" for h in self.hypotheses)
        run = PlannedPattern(self.best.pattern, f"to tell apart: {told} ({self.best.sigmas:.2g} sigmas)")
        text = plan_text(f"{self.dataset.name}, next run", robot, self.rig.rate, [run], noise=self.dataset.position_noise)
        write_atomically(path, text)


@dataclass(frozen=True)
class NextRunOptions:
    """Options of a proposed run.

    Attributes:
        seconds: its length.
        seed: of what is drawn.
        loads: whether a known constant force may act on the tip.
    """

    seconds: float = 30.0
    seed: int = 0
    loads: bool = True


def run_next(
    found: str | Path, options: NextRunOptions | None = None, data: Sequence[str | Path] = (), despite_errors: bool = False,
    progress: Progress = silent,
) -> NextRun:  # fmt: skip
    """Propose the run that best separates what `tepm discrepancy` could not.

    Args:
        found: folder with its verdict.json and model.toml.
        options: of the run.
        data: data sets that the verdict is about, the first one first; where verdict.json says absent.
        despite_errors: whether to go on where the check of the data finds errors.
        progress: told of every piece of work.

    Raises:
        InputError: no verdict, data that are gone, nothing to tell apart, a length that is not valid.
    """
    found, options = Path(found), options or NextRunOptions()
    if not SHORTEST <= options.seconds <= LONGEST:
        raise InputError(f"--seconds {options.seconds:g}; valid: {SHORTEST:g} … {LONGEST:g} s")
    content = read_verdict(found)
    folders = [Path(each) for each in data] or [found / each for each in content.get("data", [])]
    if not folders:
        raise InputError(f"{found / VERDICT}: does not say which data it is about; name them with --data")
    dataset, _ = checked_datasets(folders, despite_errors)
    if dataset.static or dataset.sample_rate is None:
        raise InputError(f"{folders[0]}: data of equilibria; valid: runs of a motion")
    file = content.get("model")
    known = read_model(found / file) if file else Model.from_robot(dataset.robot)
    channels, noise = channels_of(known.robot), noise_of(dataset)
    progress("compiling a model with all effects at their null values", 0, 0)
    network = SearchableNetwork.from_model(known, channels)
    _ = network.model.stepper  # made once, for all models with other values
    problem = Problem(
        network, dataset.fit, network.free(network.known), noise, step=LONGEST_STEP, derivatives_apart=network.derivatives_apart
    )
    fits = Fits(problem, SearchSettings.for_plant(network), progress=progress)
    hypotheses = refit_hypotheses(content, _find_corrections(found, known, network), fits, network.candidates)
    rig = Rig(known, reach_of(compile_model(known)), dataset.sample_rate, noise, options.seconds, options.loads)
    estimates = [hypothesis.estimate for hypothesis in hypotheses]
    best = best_run(rig, estimates, options.seed, progress)
    return NextRun(tuple(hypotheses), best, any_run(rig, estimates, options.seed), rig, dataset)


def _find_corrections(folder: Path, known: Model, network: SearchableNetwork) -> set[str]:
    """Find labels of effects that the verdict's model adds to the known one, and names of the robot file's values that it changes."""
    if not (folder / MODEL).is_file():
        raise InputError(f"{folder / MODEL} is not there; valid: the folder that tepm discrepancy wrote (--out)")
    model = read_model(folder / MODEL)
    changed = {name for name, value in model.parameters.items() if name not in network.known and value != known.values[name]}
    return {effect.label for effect in model.effects} - {effect.label for effect in known.effects} | changed

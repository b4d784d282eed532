"""The standard recording plan of a robot, and what it will tell before anything moves."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tepm_opt.data.datasets import in_session
from tepm_opt.data.files import output_folder, write_atomically
from tepm_opt.discrepancy.adapters.network import SearchableNetwork
from tepm_opt.discrepancy.experiments.information import Information, Move, Separability, information
from tepm_opt.discrepancy.experiments.settings import DEFAULT as EXPERIMENT
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.errors import InputError
from tepm_opt.models.channels import channels_of
from tepm_opt.models.compile import compile_model
from tepm_opt.models.model import Model
from tepm_opt.models.robot import builtin_robots
from tepm_opt.progress import Progress, silent
from tepm_opt.recording.patterns import PatternContext
from tepm_opt.recording.plan import PlannedRun, RecordingPlan
from tepm_opt.recording.reach import Reach, reach_of, unbearable
from tepm_opt.recording.standard import PLANS, PlannedPattern, plan_text, sample_rate
from tepm_opt.solvers.mechanics.plant import PredictionError

SHARES = (1.0, 0.8, 0.6, 0.45, 0.3)
"""Factors on the levels of a plan, tried one after the other until the model bears all runs."""
HEAD = (
    "A recording plan for identification and the search for missing effects: tepm record PLAN --rig RIG --out DATASET.",
    "Every input alone and all together, up and back, slow and quick, with and without loads. docs/how-to/recording.md explains every key.",
)


@dataclass(frozen=True, eq=False)
class Standard:
    """The standard plan of a model's robot.

    Attributes:
        model: that bears it.
        reach: its levels and sway.
        share: of the levels that is used.
        runs: in order.
        plan: the same with all inputs worked out.
    """

    model: Model
    reach: Reach
    share: float
    runs: tuple[PlannedPattern, ...]
    plan: RecordingPlan

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Standard({self.plan!r}, sway {self.reach.sway:.3g} Hz)"

    def text(self, folder: Path) -> str:
        """The plan file as it stands in a folder."""
        source = self.model.source
        robot = source if source in builtin_robots() else Path(os.path.relpath(source, folder)).as_posix()
        return plan_text(self.plan.name, robot, self.plan.sample_rate, self.runs, HEAD)


PURPOSES = {"standard": "identification", "wiring": "wiring"}


def standard(model: Model, plan: str = "standard") -> Standard:
    """A plan made for a robot, with levels that the model bears: stable at every set point, and with a motion between them.

    Args:
        model: of the robot.
        plan: "standard", with all that tells effects apart, or "wiring", with every input alone for a few seconds.

    Raises:
        InputError: the robot does not stand, or does not bear even a third of the levels.
    """
    compiled, robot = compile_model(model), model.robot
    reach, rate, why = reach_of(compiled), sample_rate(model.robot), ""
    for share in SHARES:
        patterns = PLANS[plan](robot, reach, share)
        runs = [
            PlannedRun(p.pattern.file, p.pattern.role, p.pattern.setpoints(PatternContext(robot, rate, Path(), p.pattern.file)))
            for p in patterns
        ]
        reasons = ((run.file, unbearable(compiled, run.setpoints)) for run in runs)
        why = next((f"{file}: {reason}" for file, reason in reasons if reason), "")
        if not why:
            recorded = RecordingPlan(f"{robot.name}, {PURPOSES[plan]}", robot, model.source, rate, None, tuple(runs))
            return Standard(model, reach, share, patterns, recorded)
    raise InputError(f"robot {robot.name}: it does not bear the {plan} plan, not even {SHARES[-1]:.0%} of its levels: {why}")


@dataclass(frozen=True, eq=False)
class ExciteRun:
    """A standard plan and what it will tell.

    Attributes:
        standard: the plan.
        noise: assumed, 1 sigma per axis in m.
        information: of its runs of role "fit".
        separable: every change of every effect.
        units: by full name of a parameter.
    """

    standard: Standard
    noise: float
    information: Information
    separable: tuple[Separability, ...]
    units: Mapping[str, str]

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"ExciteRun({self.standard!r}, {len(self.separable)} changes of effects)"

    @property
    def ok(self) -> bool:
        """Whether every effect shows."""
        return all(math.isfinite(each.found) for each in self.separable)

    @property
    def hardest(self) -> tuple[Separability, ...]:
        """The change of each effect, of its details and parameters, that is hardest to tell from its closest rival; hardest last."""
        worst: dict[str, Separability] = {}
        for each in self.separable:
            name = each.move.candidate.name if each.move.candidate.part != "parameter" else each.move.candidate.label
            if name not in worst or (each.apart, each.found) > (worst[name].apart, worst[name].found):
                worst[name] = each
        return tuple(sorted(worst.values(), key=lambda each: each.cosine))

    def size(self, move: Move, multiple: float) -> str:
        """A change of an effect at a multiple of its probe, in words with units: "loss 0.0012"."""
        if not math.isfinite(multiple):
            return "none"
        many = len(move.probe) > 3
        parts = [
            f"{name.rpartition('.')[2]} {abs(value - move.null[name]):.2g} {self.units[name].strip('-1')}".rstrip()
            for name, value in move.values_at(multiple).items()
            if value != move.null[name]
        ]
        return f"{multiple:.2g} times its probe" if many else ", ".join(parts)

    def summary(self) -> dict[str, Any]:
        """Numbers of the plan and of all changes of effects, plain data."""
        plan, reach = self.standard.plan, self.standard.reach
        return {
            "robot": plan.robot.name,
            "runs": len(plan.runs),
            "seconds": round(sum(float(run.setpoints.time[-1]) for run in plan.runs), 1),
            "sway_Hz": _number(reach.sway),
            "share_of_levels": self.standard.share,
            "noise_m": _number(self.noise),
            "found_at_sigmas": EXPERIMENT.found_sigmas,
            "apart_at_sigmas": EXPERIMENT.apart_sigmas,
            "effects": [self._entry(each) for each in self.separable],
        }

    def _entry(self, each: Separability) -> dict[str, Any]:
        move = each.move
        return {
            "effect": move.candidate.label,
            "found": self._values(move, each.found),
            "material": self._values(move, each.material),
            "rival": each.rival.label if each.rival else None,
            "cosine": _number(each.cosine),
            "apart": self._values(move, each.apart),
        }

    def _values(self, move: Move, multiple: float) -> dict[str, float | None]:
        return {name: _number(value - move.null[name]) for name, value in move.values_at(multiple).items() if value != move.null[name]}

    def save(self, path: str | Path) -> None:
        """Write the plan file, and what it will tell beside it as JSON.

        Raises:
            InputError: the folder cannot be written to.
        """
        path = Path(path)
        folder = output_folder(path.parent)
        write_atomically(path, self.standard.text(folder))
        write_atomically(path.with_suffix(".json"), json.dumps(self.summary(), indent=2) + "\n")


def _number(value: float) -> float | None:
    """Four digits; None for what is not a number."""
    return float(f"{value:.4g}") if math.isfinite(value) else None


def run_excite(model: Model, noise: float | None = None, progress: Progress = silent) -> ExciteRun:
    """The standard plan of a model's robot, and which effects of the library it will show at which size.

    Args:
        model: what is known of the machine.
        noise: of the tracker, 1 sigma per axis in m; the robot file's where absent.
        progress: told of every piece of work.

    Raises:
        InputError: the robot does not bear a plan; noise that is not positive.
    """
    noise = model.robot.tracker.noise_rms_m / math.sqrt(3) if noise is None else noise
    if not (math.isfinite(noise) and noise > 0):
        raise InputError(f"noise {noise:g} m; valid: above 0, 1 sigma per axis (--noise), where the robot file has none")
    progress("finding levels that the robot bears", 0, 0)
    found = standard(model)
    plan, channels = found.plan, channels_of(model.robot)
    progress("compiling a model with all effects at their null values", 0, 0)
    network = SearchableNetwork.from_model(model, channels)
    sampled = in_session([run.sample_at(plan.sample_rate, len(channels.points)) for run in plan.runs], {})
    progress(f"what {len(network.candidates)} effects would change", 0, 0)
    try:
        told = information(network, [run for run in sampled if run.role == "fit"], noise, network.candidates)
    except PredictionError as error:
        raise InputError(f"robot {model.robot.name}: the model cannot do the runs of the plan: {error}") from error
    least = SearchSettings.for_plant(network).min_excess_removed
    names: Sequence[str] = [name for move in told.moves for name in move.probe]
    units = {free.name: free.unit for free in network.free(list(dict.fromkeys(names)))}
    return ExciteRun(found, noise, told, tuple(told.separability(move, least) for move in told.moves), units)

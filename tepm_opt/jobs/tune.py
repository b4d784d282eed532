"""Tuning of the predictive controller's Kalman filter on the log of one closed-loop run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.control.estimation.filter_tuning import HORIZONS, Candidate, FilterInputs, compare_scales
from tepm_opt.control.mpc.compiled.setup import StepSetup
from tepm_opt.control.mpc.settings import MpcSettings
from tepm_opt.control.mpc.state import MpcState, OperatingPoints
from tepm_opt.control.references.reference import PERIOD, reference_of
from tepm_opt.data.run import Run, read_run
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.jobs.closed_loop import LOG
from tepm_opt.models.channels import channels_of
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.model import FILTER_UNITS, Model, write_model
from tepm_opt.progress import Progress, silent

TARGET = tuple(f"target_{axis}_m" for axis in "xyz")


@dataclass(frozen=True, eq=False)
class TuneRun:
    """Result of a tuning.

    Attributes:
        model: with the chosen settings.
        log: file of the closed loop.
        seconds: duration of the log in s.
        candidates: all that were compared, the hand-set values first.
    """

    model: Model
    log: Path
    seconds: float
    candidates: tuple[Candidate, ...]

    def __repr__(self) -> str:
        scales = f"travel × {self.chosen.travel:g}, friction × {self.chosen.friction:g}, strength × {self.chosen.strength:g}"
        return f"TuneRun({self.log}: {scales})"

    @property
    def chosen(self) -> Candidate:
        """The candidate with the least criterion, of those with the travel that was taken."""
        return min((each for each in self.candidates if each.travel == self.candidates[-1].travel), key=lambda each: each.criterion)

    @property
    def ok(self) -> bool:
        """Whether there is a result; always, as the hand-set values are a candidate."""
        return True

    def summary(self) -> dict[str, Any]:
        """Numbers, plain data."""

        def numbers_of(each: Candidate) -> dict[str, Any]:
            errors = {f"{horizon:.2f}": error for horizon, error in zip(HORIZONS, each.errors, strict=True)}
            scales = {"travel_scale": each.travel, "friction_scale": each.friction, "strength_scale": each.strength}
            return scales | {"prediction_error_m": errors}

        return {
            "robot": self.model.robot.name,
            "log": str(self.log),
            "seconds": self.seconds,
            "candidates": [numbers_of(each) for each in self.candidates],
            "chosen": numbers_of(self.chosen),
            "filter": dict(self.model.filter),
        }

    def save(self, path: str | Path) -> None:
        """Write the model file.

        Raises:
            InputError: it cannot be written.
        """
        write_model(self.model, path)


def read_log(path: str | Path, model: CompiledModel) -> Run:
    """The log of a closed loop, given by its file or folder.

    Raises:
        InputError: unreadable, of another robot, without targets, or with another period than the controller's.
    """
    path = Path(path) / LOG if Path(path).is_dir() else Path(path)
    run = read_run(path, channels=channels_of(model.robot))
    for name in TARGET:
        if name not in run.extra or not np.isfinite(run.extra[name]).all():
            raise InputError(f"{path}: column {name!r} is missing or has gaps; valid: log.csv of tepm mpc")
    apart = float(np.median(np.diff(run.time))) if run.rows > 1 else 0.0
    if abs(apart - PERIOD) > 0.1 * PERIOD:
        raise InputError(f"{path}: samples are {apart:g} s apart; valid: {PERIOD:g} s")
    return run


def filter_inputs(model: CompiledModel, run: Run, progress: Progress = silent) -> FilterInputs:
    """Replay actuators, delays and local models of a log as the controller's step has them; the filter's inputs.

    Args:
        model: of the controller.
        run: from `read_log`; periods without a sample have no points.
        progress: told of the inverse kinematics and of the replay.

    Raises:
        InputError: a target is out of the model's reach.
    """
    rows = np.round((run.time - run.time[0]) / PERIOD).astype(int)
    targets = np.array([np.interp(np.arange(rows[-1] + 1), rows, run.extra[name]) for name in TARGET]).T
    reference = reference_of(model, targets, progress=progress)
    setup = StepSetup.from_model(model, reference, MpcSettings(), 0.0)
    about = OperatingPoints(setup)
    state = MpcState.at_rest(setup, about.find(0))
    samples = dict(zip(rows.tolist(), _samples(run, model.layout.actuator_names), strict=True))
    points = np.full((len(targets), model.layout.points, 3), np.nan)
    operating, noise, forces, tensions, last = [], [], [], [], 0
    for row in range(len(targets)):
        operating.append(about.find(row))
        noise.append(state.noise.measured)
        if row in samples:
            sample, command = samples[row]
            state.sent.take_time(sample.time)
            state.actuators.command = state.sent.command_at(row)
            state.actuators.correct(sample, (row - last) * PERIOD)
            state.effects.advance(state.actuators, PERIOD)
            state.sent.send(sample.time, command)
            state.sent.postpone(state.actuators.adopt_delay(PERIOD))
            state.noise.add(sample.points)
            points[row], last = sample.points, row
        state.actuators.command = state.sent.command_at(row)
        forces.append(state.actuators.advance() + state.effects.forces)
        tensions.append(state.actuators.tension)
        progress("replaying the log", row + 1, len(targets))
    rates = np.diff(setup.reference.lengths, axis=0) / PERIOD
    middle = setup.controller.mid_range * float(setup.tension_max[0])
    return FilterInputs(operating, np.array(noise), points, np.array(forces[:-1]), np.array(tensions[:-1]), rates, middle)


def _samples(run: Run, names: tuple[str, ...]) -> list[tuple[Sample, Command]]:
    """Samples of a log with the commands that answered them; gauges only where the rig had them."""

    def columns(form: str) -> np.ndarray | None:
        found = [run.extra[column] for name in names if (column := form.format(name)) in run.extra]
        return np.array(found).T if len(found) == len(names) else None

    pressures, tensions, on = columns("pressure_{}_measured_Pa"), columns("tension_{}_measured_N"), columns("enabled_{}")
    on, half = np.ones((run.rows, len(names))) if on is None else on, len(names)
    gauges = [(None if pressures is None else pressures[k], None if tensions is None else tensions[k]) for k in range(run.rows)]
    return [
        (Sample(run.time[k], run.points[k], pressures=p, tensions=t), Command(run.inputs[k, :half], run.inputs[k, half:], on[k] > 0.5))
        for k, (p, t) in enumerate(gauges)
    ]


def run_tune(model: CompiledModel, log: str | Path, progress: Progress = silent) -> TuneRun:
    """Choose the travel over which friction turns over and the filter's noise levels of friction and muscle strength by the prediction
    errors over a closed-loop log.

    Args:
        model: of the controller that drove the loop; of its own `filter` the presliding distance counts alone.
        log: log.csv of `tepm mpc`, or its folder.
        progress: told of every part.

    Raises:
        InputError: see `read_log`; a log that is too short, or without the tip.
    """
    run = read_log(log, model)
    try:
        own = model.model.filter.get("presliding_distance")
        candidates = compare_scales(filter_inputs(model, run, progress), model.tendon_friction, own, progress)
    except InputError as error:
        raise InputError(f"{log}: {error}") from error
    found = TuneRun(model.model, Path(log), float(np.ptp(run.time)), candidates)
    kept = {name: float(getattr(found.chosen.settings, name)) for name in FILTER_UNITS}
    return replace(found, model=replace(model.model, filter=kept))

"""Computation and files of `tepm simulate`: the motion under a file's inputs, beside measured points where it has any.

The motion is kept at least every 40 ms, also between rows that lie further apart: figures then show the sway between them. Tables hold
the file's rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.channels import TIME, Channels
from tepm_opt.data.files import output_folder
from tepm_opt.data.frames import Tabular
from tepm_opt.data.metrics import error_over_time, point_errors, shape_error
from tepm_opt.data.run import Run, read_run_table, refuse_unusable, run_columns, run_of, write_run
from tepm_opt.data.setpoints import SetPoints, length_columns, point_columns, refuse_out_of_range
from tepm_opt.data.tables import write_table
from tepm_opt.errors import InputError
from tepm_opt.jobs.output import save_summary
from tepm_opt.models.compile import CompiledModel
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.mechanics.simulate import Directions, Method, Simulation, simulate

DENSE = 0.04  # s between two kept instants
MOST_ADDED = 20000  # instants between the rows
TRAJECTORY, LENGTHS, SENSITIVITIES = "trajectory.csv", "lengths.csv", "sensitivities.csv"
PERCENT = 0.01


@dataclass(frozen=True, eq=False)
class SimulationTask:
    """Set points to simulate, with the points measured then where there are any.

    Attributes:
        setpoints: inputs and tip force, (rows, …).
        measured: points of a recorded run in G, (rows, points, 3) in m, NaN where missing; None where the file has none.
        hold: whether a row holds until the next one, instead of changing linearly.
        directions: parameters and inputs by which the motion is differentiated; None for none.
    """

    setpoints: SetPoints
    measured: np.ndarray | None = None
    hold: bool = False
    directions: Directions | None = None


def read_task(path: str | Path, model: CompiledModel) -> SimulationTask:
    """A set-point file, or a run of a data set (the same columns and the measured points).

    Raises:
        InputError: with file, line and column: unreadable, a column missing or of another robot, an input that is empty, not finite
            or out of range, time that does not increase, one row alone.
    """
    table, names = read_run_table(path), model.layout.actuator_names
    recorded = bool(Channels.from_header(table.columns).points)
    channels = Channels(names, model.layout.point_names if recorded else ())
    run = run_of(table, Path(path).name, "validation", channels, static=False)
    refuse_unusable(table, channels, static=False)
    refuse_out_of_range(table, channels.inputs, model.input_max)
    if run.rows < 2:
        raise InputError(f"{path}: 1 row; valid: at least 2, the motion lasts from the first to the last")
    return SimulationTask(SetPoints(run.time, run.inputs, run.tip_force), run.points if recorded else None)


def densify_inputs(setpoints: SetPoints, hold: bool) -> tuple[SetPoints, np.ndarray]:
    """Interpolate inputs to at most 40 ms apart (more in very long files); with the places (rows,) of the rows among them."""
    time = setpoints.time
    spacing = max(DENSE, float(time[-1] - time[0]) / MOST_ADDED)
    parts = np.maximum(1, np.ceil(np.diff(time) / spacing * (1 - 1e-9)).astype(int))
    places = np.concatenate([[0], np.cumsum(parts)])
    start = np.repeat(np.arange(len(parts)), parts)
    weight = (np.arange(places[-1]) - places[start]) / parts[start]
    last = len(time) - 1

    def interpolate(values: np.ndarray, held: bool) -> np.ndarray:
        w = weight.reshape(-1, *(1,) * (values.ndim - 1))
        filled = values[start] if held else values[start] + w * (values[start + 1] - values[start])
        return np.concatenate([filled, values[last:]])

    return SetPoints(interpolate(time, False), interpolate(setpoints.inputs, hold), interpolate(setpoints.tip_force, hold)), places


@dataclass(frozen=True, eq=False)
class SimulateRun(Tabular):
    """A simulation of a file's inputs.

    Attributes:
        simulation: the motion, as far as it got, at the file's rows and between them.
        places: of the file's rows among the simulation's instants, (rows done,).
        asked: rows of the file.
        duration: from the file's first to its last row in s.
        hold: whether a row holds until the next one.
        measured: points of the recorded run in G at the rows done, (rows done, points, 3) in m; None where there are none.
    """

    simulation: Simulation
    places: np.ndarray
    asked: int
    duration: float
    hold: bool
    measured: np.ndarray | None = None

    @property
    def failure(self) -> str:
        """Reason why the motion ended early by itself; empty where it did not."""
        return self.simulation.outcome.message if self.simulation.outcome.ending is Ending.FAILED else ""

    @property
    def interrupted(self) -> bool:
        """Whether the user ended it early."""
        return self.simulation.outcome.ending is Ending.INTERRUPTED

    def __repr__(self) -> str:
        return f"<SimulateRun {self.outcome}; {len(self.places)} of {self.asked} rows, {self.duration:.4g} s of {self.model.robot.name}>"

    @property
    def outcome(self) -> Outcome:
        """Outcome: solved where the motion came to the end of the file."""
        return self.simulation.outcome

    @property
    def model(self) -> CompiledModel:
        """The model that moved."""
        return self.simulation.model

    @property
    def ok(self) -> bool:
        """Whether it came to the end."""
        return self.outcome.solved

    @property
    def time(self) -> np.ndarray:
        """Time of the rows done in s, (rows done,)."""
        return self.simulation.setpoints.time[self.places]

    @property
    def points(self) -> np.ndarray:
        """Reference points in G at the rows done, (rows done, points, 3) in m."""
        return self.simulation.points[self.places]

    def run(self) -> Run:
        """The rows done as a run of a data set."""
        setpoints = self.simulation.setpoints
        inputs, force = setpoints.inputs[self.places], setpoints.tip_force[self.places]
        return Run(TRAJECTORY, "validation", self.time, inputs, force, self.points)

    def errors(self) -> np.ndarray | None:
        """Eq. (5) against the measured points at the rows done, (rows done,) in m; None where nothing was measured."""
        if self.measured is None or not np.isfinite(self.measured).any():
            return None
        return shape_error(self.measured, self.points)

    def tip_changes(self) -> dict[str, float]:
        """Largest change of the tip in m by 1 % of each parameter's value (of each input's range) along which it was differentiated."""
        model, names = self.model, self.model.layout.actuator_names
        channels = [f"pressure_{name}" for name in names] + [f"tension_{name}" for name in names]
        unit = model.values | dict(zip(channels, model.input_max.tolist(), strict=True))
        tips = np.linalg.norm(self.simulation.sensitivities[:, :, -1], axis=-1).max(axis=1, initial=0.0)
        return {name: PERCENT * abs(unit[name]) * float(tip) for name, tip in zip(self.simulation.directions, tips, strict=True)}

    def summary(self) -> dict[str, Any]:
        """Numbers of the run."""
        simulation, effort, errors = self.simulation, self.simulation.effort, self.errors()
        summary: dict[str, Any] = {
            "robot": self.model.robot.name,
            "method": simulation.method,
            "step_s": simulation.step,
            "estimated_error_m": None if np.isnan(simulation.error) else simulation.error,
            "inputs_between_rows": "held" if self.hold else "linear",
            "rows": self.asked,
            "simulated": len(self.places),
            "duration_s": self.duration,
            "reached_s": float(simulation.setpoints.time[-1] - simulation.setpoints.time[0]) if len(self.places) else 0.0,
            "steps": int(effort.steps),
            "iterations": int(effort.iterations),
            "halvings": int(effort.halvings),
            "interrupted": self.interrupted,
            "failure": self.failure or None,
        }
        if len(self.places):
            summary["last_tip_m"] = self.points[-1, -1].tolist()
        if simulation.directions:
            summary["largest_tip_change_by_1_percent_m"] = self.tip_changes()
        if errors is not None and self.measured is not None:
            squares = [column[np.isfinite(column)] ** 2 for column in point_errors(self.measured, self.points).T]
            by_point = [float(np.sqrt(column.mean())) if column.size else None for column in squares]
            summary["measured"] = {
                "error_rms_m": error_over_time(self.measured, self.points),
                "largest_error_m": float(np.nanmax(errors)),
                "point_error_rms_m": dict(zip(self.model.layout.point_names, by_point, strict=True)),
            }
        return summary

    def columns(self) -> dict[str, np.ndarray]:
        """The rows done as a run of a data set, with the actuators' lengths."""
        layout, lengths = self.model.layout, self.simulation.lengths[self.places]
        names = length_columns(layout.actuator_names)
        return run_columns(self.run(), Channels(layout.actuator_names, layout.point_names)) | dict(zip(names, lengths.T, strict=True))

    def save(self, folder: str | Path) -> None:
        """Write trajectory.csv, lengths.csv, summary.json and, where asked for, sensitivities.csv; nothing where no row was finished.

        A sensitivities.csv of an earlier run goes.

        Raises:
            InputError: the folder cannot be written to.
        """
        if not len(self.places):
            return
        folder, layout, simulation = output_folder(folder), self.model.layout, self.simulation
        write_run(folder / TRAJECTORY, self.run(), Channels(layout.actuator_names, layout.point_names))
        lengths = simulation.lengths[self.places]
        write_table(folder / LENGTHS, [TIME, *length_columns(layout.actuator_names)], np.column_stack([self.time, lengths]))
        (folder / SENSITIVITIES).unlink(missing_ok=True)
        if simulation.directions:
            names = [f"{column}_per_{name}" for name in simulation.directions for column in point_columns(layout.point_names)]
            values = np.moveaxis(simulation.sensitivities[:, self.places], 0, 1).reshape(len(self.places), -1)
            write_table(folder / SENSITIVITIES, [TIME, *names], np.column_stack([self.time, values]))
        save_summary(folder, "simulate", self.summary())


def run_simulation(
    model: CompiledModel, task: SimulationTask, method: Method = "implicit", step: float | None = None, error: float | None = None,
    progress: Progress = silent,
) -> SimulateRun:  # fmt: skip
    """Simulate a task from rest under its first row.

    An interruption (Ctrl-C) and a motion that leaves all bounds end it early; the run says so and holds what was done.

    Args:
        model: compiled model.
        task: inputs and, where there are any, measured points.
        method: implicit, or the paper's.
        step: longest in s; adaptive (implicit) or the method's own where absent.
        error: of the nodes in m at which adaptive steps aim.
        progress: told how much of it is done, in s.

    Raises:
        InputError: as for `simulate`.
    """
    dense, places = densify_inputs(task.setpoints, task.hold)
    found = simulate(model, dense, method, step, task.hold, None, task.directions, progress=progress, error=error)
    done = places[places < len(found.setpoints.time)]
    measured = None if task.measured is None else task.measured[: len(done)]
    duration = float(task.setpoints.time[-1] - task.setpoints.time[0])
    return SimulateRun(found, done, len(places), duration, task.hold, measured)

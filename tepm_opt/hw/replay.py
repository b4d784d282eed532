"""A rig that plays recorded data back: for controllers, estimators and views that shall see what was once measured."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import TracebackType

import numpy as np

from tepm_opt.data.run import Run, read_run
from tepm_opt.errors import InputError
from tepm_opt.hw.commands import check_command
from tepm_opt.hw.freshness import DeclaredNoise, FreshnessMonitor
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot, load_robot

LEAST_ROWS, NOISY = 20, 0.2
"""Rows of a recording from which its noise can be seen, and the part of the declared noise that it has to have."""


class EndOfRecording(EOFError):  # noqa: N818  it says what happened
    """There are no more samples."""


class ReplayRig:
    """The samples of one run of a data set (SPEC section 4), one a `read`; commands are checked and otherwise ignored.

    Args:
        source: a run, or the path of its CSV file.
        robot: the robot, its name or its file's path.
        wait: called with the time in s until each next sample, as `time.sleep` for playing in real time; by default time is virtual.

    Attributes:
        robot: as its file says.
        time: of the last sample in s since the first row.

    Raises:
        InputError: unreadable file, or columns that are not the robot's.
    """

    def __init__(
        self, source: Run | str | Path, robot: Robot | str | Path = "kang2017", wait: Callable[[float], None] = lambda _: None
    ) -> None:
        self.robot = robot if isinstance(robot, Robot) else load_robot(robot)
        self.layout = Layout.from_robot(self.robot)
        self.run = source if isinstance(source, Run) else read_run(source)
        self.time = 0.0
        self._wait = wait
        self._row = 0
        rows, places = self.run.rows, (self.layout.inputs, self.layout.points)
        if (self.run.inputs.shape[1], self.run.points.shape[1]) != places:
            found = f"{self.run.inputs.shape[1]} inputs and {self.run.points.shape[1]} points"
            raise InputError(f"{self.run.file}: {found}; {self.robot.name} has {places[0]} and {places[1]}")
        if rows == 0 or not np.isfinite(self.run.time).all():
            raise InputError(f"{self.run.file}: cannot be played back: it has no rows or no time")
        rate = 1 / float(np.median(np.diff(self.run.time))) if rows > 1 else self.robot.tracker.rate_Hz
        self._freshness = FreshnessMonitor(self.layout, self.robot.input_max, self._declared_noise(), rate)

    def __repr__(self) -> str:
        return f"ReplayRig({self.run.file!r}, row {self._row} of {self.run.rows})"

    def read(self) -> Sample:
        """The next row: points, and where recorded measured pressures, tensions and lengths; other columns of numbers as `extra`.

        Raises:
            EndOfRecording: all rows were read.
        """
        if self._row == self.run.rows:
            raise EndOfRecording(f"{self.run.file}: the recording ended after {self.run.rows} samples, at {self.time:.3f} s")
        row, time = self._row, float(self.run.time[self._row] - self.run.time[0])
        self._wait(time - self.time)
        self.time = time
        self._row += 1
        measured = [self._read_measured_row(form, row) for form in ("pressure_{}_measured_Pa", "tension_{}_measured_N", "length_{}_m")]
        extra = {name: float(values[row]) for name, values in self.run.extra.items() if values.dtype.kind == "f"}
        points = self.run.points[row].copy()
        lost = [name for name, point in zip(self.layout.point_names, points, strict=True) if np.isnan(point).any()]
        sample = Sample(time, points, *measured, status=f"tracker lost {', '.join(lost)}" if lost else "ok", extra=extra)
        return self._freshness.look(sample, self.run.inputs[row])

    def apply(self, command: Command) -> None:
        """Check a command; the recording goes on as it was.

        Raises:
            InputError: a value is NaN or outside the robot's limits.
        """
        check_command(command, self.robot)

    def stop(self) -> None:
        """Do nothing: in a recording nothing moves."""

    @property
    def simulated(self) -> None:
        """A recording is no simulation."""
        return None

    @property
    def recorded(self) -> Command:
        """The set points of the last sample's row (the first row's before the first `read`); recordings do not have ENA, so all are on."""
        return Command.from_inputs(self.run.inputs[max(self._row - 1, 0)])

    def __enter__(self) -> ReplayRig:
        """The rig itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Stop."""
        self.stop()

    def _declared_noise(self) -> DeclaredNoise:
        """The noise that the robot file declares, of which points in the recording have a fifth at least: a recording may be of something
        noiseless, or hold the samples of a slower sensor."""
        noise, points = DeclaredNoise.of_robot(self.robot), self.run.points
        rough = np.abs(np.diff(points, 3, axis=0)) if len(points) > LEAST_ROWS else np.zeros(1)
        rough = rough[np.isfinite(rough)]
        sigma = float(np.median(rough)) / 0.6745 / math.sqrt(20) if len(rough) else 0.0  # third differences have 20 times the variance
        return noise if sigma >= NOISY * noise.point else replace(noise, point=0.0)

    def _read_measured_row(self, form: str, row: int) -> np.ndarray | None:
        columns = [self.run.extra.get(form.format(name)) for name in self.layout.actuator_names]
        present = [column for column in columns if column is not None]
        return np.array([column[row] for column in present]) if len(present) == len(columns) else None

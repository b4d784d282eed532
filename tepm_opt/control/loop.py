"""The closed loop on any rig: slowly to the start, a look whether rig and model agree, then the reference, period by period."""

from __future__ import annotations

import contextlib
import gc
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tepm_opt.control.controller import Controller, Prepares, Telemetry
from tepm_opt.control.guard import Guard, Supervisor
from tepm_opt.control.references.reference import Reference
from tepm_opt.errors import InputError
from tepm_opt.hw.commands import check_command
from tepm_opt.hw.guard import Stopped
from tepm_opt.hw.ramp import smooth_ramp, smooth_step
from tepm_opt.hw.rig import Command, Rig, Sample
from tepm_opt.models.robot import Robot
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.progress import Progress, silent

Observer = Callable[[Sample, np.ndarray], None]
"""Callback of a live view: takes every sample and the tip's target, (3,) in m."""
SWITCH = 1e-4  # s after which a thread that waits may go on while a loop is closed
DONE = Outcome(Ending.DONE)
INTERRUPTED = Outcome(Ending.INTERRUPTED, "interrupted by the user")


@dataclass(frozen=True, eq=False)
class LoopStep:
    """One control period of a closed loop.

    Attributes:
        row: of the reference.
        time: of the sample since the loop was closed, in s.
        sample: that the controller got.
        command: that it gave.
        seconds: that it took.
    """

    row: int
    time: float
    sample: Sample
    command: Command
    seconds: float


@dataclass(eq=False)
class LoopRecord:
    """Record of a closed loop, one row a sample. It is filled as the loop runs, so that what was done is there if it ends early.

    Attributes:
        reference: what was to be followed.
        rows: of the reference, one a sample.
        time: of the samples since the loop was closed, in s.
        points: tracked, (points, 3) in m each; NaN where lost.
        truth: true tip, (3,) in m each, where the rig knows it; else NaN.
        commands: as sent.
        measured: pressures and tensions (2 · actuators,) where the rig measures both, else NaN.
        seconds: that the controller took, one a sample.
        distance: true least distance of the arm to obstacles in m, where the rig knows it, else NaN; none where there are no obstacles.
        telemetry: what the controller logs, one a sample; written last, so that rows before its end are whole.
        outcome: how it ended, and why.
    """

    reference: Reference
    rows: list[int] = field(default_factory=list)
    time: list[float] = field(default_factory=list)
    points: list[np.ndarray] = field(default_factory=list)
    truth: list[np.ndarray] = field(default_factory=list)
    commands: list[Command] = field(default_factory=list)
    measured: list[np.ndarray] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    distance: list[float] = field(default_factory=list)
    telemetry: list[Telemetry] = field(default_factory=list)
    outcome: Outcome = DONE

    @property
    def fallbacks(self) -> Mapping[str, int]:
        """Number of steps of the controller that went on with something older, by the reason."""
        return self.telemetry[-1].fallbacks if self.telemetry else {}

    def __repr__(self) -> str:
        until = f"{self.time[-1]:.2f} s" if self.time else "no sample"
        return f"LoopRecord({self.outcome}, samples={len(self.rows)}, until={until})"

    @property
    def targets(self) -> np.ndarray:
        """Targets of the tip, (samples, 3) in m."""
        return self.reference.path[np.array(self.rows, dtype=int)]

    @property
    def counted(self) -> np.ndarray:
        """Samples over which the error counts, (samples,) of bool."""
        return self.reference.counted[np.array(self.rows, dtype=int)]

    def error(self, true: bool = True) -> float:
        """Root mean square of the tip's distance from its target where it counts, in m: of the true tip, or the tracked one.

        NaN where nothing is known of it.
        """
        tips = np.array(self.truth).reshape(-1, 3) if true else np.array([points[-1] for points in self.points]).reshape(-1, 3)
        squares = ((tips - self.targets) ** 2).sum(axis=1)[self.counted]
        known = squares[np.isfinite(squares)]
        return float(np.sqrt(known.mean())) if len(known) else float("nan")

    def add(self, step: LoopStep, rig: Rig, telemetry: Telemetry) -> None:
        """Add a period, with the truth as far as the rig knows it and what the controller logs."""
        sample, true, keep_out = step.sample, rig.simulated, self.reference.keep_out
        self.rows.append(step.row)
        self.time.append(step.time)
        self.points.append(sample.points)
        self.truth.append(np.full(3, np.nan) if true is None else true.true_points[-1])
        if keep_out is not None:
            watched = None if true is None else keep_out.stack_watched_points(true.true_points, true.true_nodes)
            self.distance.append(np.nan if watched is None else keep_out.nearest(watched).distance)
        self.commands.append(step.command)
        self.measured.append(_join_measured_inputs(sample, 2 * len(step.command.pressures)))
        self.seconds.append(step.seconds)
        self.telemetry.append(replace(telemetry, doubts={**telemetry.doubts, **sample.faults}) if sample.faults else telemetry)


def close_loop(
    rig: Rig,
    controller: Controller,
    robot: Robot,
    guard: Guard | None = None,
    progress: Progress = silent,
    observer: Observer | None = None,
    keep: LoopRecord | None = None,
) -> LoopRecord:
    """Follow a controller's reference on a rig, which is stopped at the end whatever happens.

    A rig of virtual time rests from the start where the controller wants it; any other is taken there slowly first, rests, is refused
    if the tracked points are not where the model has them, and goes back to zero slowly in the end.

    Args:
        rig: any; it is entered and left here.
        controller: with its reference.
        robot: its limits.
        guard: when to stop.
        progress: told the stage and how much of it is done, in s.
        observer: given every sample with its target.
        keep: filled, instead of a new one, so that a caller has what was done whatever is raised.

    Raises:
        InputError: a rig that does not fit the robot, or that disagrees with the model before the loop is closed.
    """
    guard, done = guard or Guard(), keep or LoopRecord(controller.reference)
    rests = rig.simulated is not None or guard.approach_time <= 0
    loop = _Loop(rig, controller, guard, Supervisor(guard, robot), progress)
    with rig, pause_garbage_collection():
        try:
            start = controller.start()
            check_command(start, robot)
            first = loop.read_first(start) if rests else loop.approach(start)
            loop.follow(first, done, observer)
            if not rests:
                loop.return_to_zero(done.commands[-1])
        except Stopped as stop:
            done.outcome = stop.outcome
        except KeyboardInterrupt:
            done.outcome = INTERRUPTED
        except EOFError as error:
            done.outcome = Outcome(Ending.OVER, str(error))
    return done


@contextlib.contextmanager
def pause_garbage_collection() -> Iterator[None]:
    """Keep Python's search for cyclic garbage off until the loop is over: it stops everything for up to some ten milliseconds.

    Threads beside the loop (the journal's) let it go on within a tenth of a millisecond instead of five.
    """
    was, interval = gc.isenabled(), sys.getswitchinterval()
    gc.disable()
    sys.setswitchinterval(SWITCH)
    try:
        yield
    finally:
        sys.setswitchinterval(interval)
        if was:
            gc.enable()


@dataclass(frozen=True, eq=False)
class _Loop:
    """A rig and its controller, with the supervisor that watches every sample."""

    rig: Rig
    controller: Controller
    guard: Guard
    supervisor: Supervisor
    progress: Progress

    def read_first(self, command: Command) -> Sample:
        """Apply a command and read the first sample under it.

        Raises:
            InputError: the rig tracks other points than the model has.
        """
        self.rig.apply(command)
        sample, expected = self.rig.read(), self.controller.reference.equilibria[0].points
        if sample.points.shape != expected.shape:
            raise InputError(f"the rig gives {len(sample.points)} points, the robot has {len(expected)}; another robot?")
        return sample

    def approach(self, start: Command) -> Sample:
        """Bring the rig slowly to where the controller starts, and let it rest there; the last sample.

        Raises:
            InputError: the tracked points are not where the model has them.
        """
        guard, expected = self.guard, self.controller.reference.equilibria[0].points
        sample = self.read_first(_part(start, 0.0))
        began, whole = sample.time, guard.approach_time + guard.settle_time
        missed: list[np.ndarray] = []
        while (passed := sample.time - began) < whole:
            self.supervisor.check(sample)
            self.rig.apply(_part(start, smooth_step(passed / guard.approach_time)))
            self.progress("to the start", passed, whole)
            if passed > guard.approach_time + guard.settle_time / 2:
                missed.append(np.linalg.norm(sample.points - expected, axis=1))
            sample = self.rig.read()
        known = np.concatenate(missed)[np.isfinite(np.concatenate(missed))] if missed else np.zeros(0)
        miss = float(np.median(known)) if len(known) else np.inf
        if not miss <= guard.start_tolerance:
            saw = f"the tracked points miss the model's by {1e3 * miss:.0f} mm" if len(known) else "the tracker sees nothing"
            need = f"valid: at most {1e3 * guard.start_tolerance:.0f} mm. Is the tracker registered (tepm hw calibrate base)?"
            raise InputError(f"at the start {saw}; {need}")
        return sample

    def follow(self, sample: Sample, done: LoopRecord, observer: Observer | None) -> None:
        """Take samples and give commands in turns until the reference ends or the guard stops it."""
        rig, controller, reference = self.rig, self.controller, self.controller.reference
        zero, row, place = sample.time, -1, 0
        while not reference.is_over(now := round((sample.time - zero) / reference.period)):
            if now > row:  # a rig may be faster than the control period
                row = now
                began = time.perf_counter()
                command = controller.command(sample)
                seconds = time.perf_counter() - began
                rig.apply(command)
                place = int(reference.rows_at(row))
                if isinstance(controller, Prepares):
                    began = time.perf_counter()
                    controller.prepare()
                    seconds += time.perf_counter() - began
                done.add(LoopStep(place, sample.time - zero, sample, command, seconds), rig, controller.telemetry())
                self.progress("tracking", sample.time - zero, reference.duration)
                if observer:
                    observer(sample, reference.tips[place])
            self.supervisor.check(sample, reference.tips[place])
            sample = rig.read()

    def return_to_zero(self, last: Command) -> None:
        """Go from the last command slowly to zero; what ends that early is stopped, which is no worse than what was to come."""
        with contextlib.suppress(EOFError, KeyboardInterrupt, Stopped):
            for passed, share in smooth_ramp(lambda: self.rig.time, self.guard.approach_time):
                self.rig.apply(_part(last, 1 - share))
                self.progress("back to zero", passed, self.guard.approach_time)
                self.supervisor.check(self.rig.read())


def _part(command: Command, part: float) -> Command:
    return Command(part * command.pressures, part * command.tensions * command.enabled, command.enabled)


def _join_measured_inputs(sample: Sample, count: int) -> np.ndarray:
    if sample.pressures is None or sample.tensions is None:
        return np.full(count, np.nan)
    return np.concatenate([sample.pressures, sample.tensions])

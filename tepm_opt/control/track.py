"""The closed loop on any rig: slowly to the start, a look whether rig and model agree, then the reference, period by period."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from tepm_opt.control.follow import Controller
from tepm_opt.control.mpc import Mpc, Step
from tepm_opt.control.reference import Reference, rising
from tepm_opt.errors import InputError
from tepm_opt.hw.commands import check_command
from tepm_opt.hw.rig import Command, Rig, Sample, Virtual
from tepm_opt.models.robot import Robot

Show = Callable[[str, float, float], None]
"""Told what goes on: stage, how much is done, of how much (s)."""
Look = Callable[[Sample, np.ndarray], None]
"""Given every sample with the tip's target (3,) in m, for a live view."""


class End(Enum):
    """How a closed loop ended."""

    DONE = "done"
    INTERRUPTED = "interrupted"
    BLIND = "the tracker saw nothing"
    DISAGREED = "the rig and the reference disagree"
    LIMIT = "a measured tension or pressure is beyond its limit"
    OVER = "the rig has no more samples"


@dataclass(frozen=True)
class Guard:
    """What the closed loop stops at.

    Attributes:
        glide: s in which a rig that stands at zero is taken to the start; 0 for one that rests from the start where it is commanded to.
        rest: s for which it rests there before the loop is closed.
        agree: m by which points at the start may miss the model's, on average.
        far: m by which the tip may be off the reference while the loop is closed, for `patience` s.
        blind: s without any tracked point.
        beyond: part of its range by which a measured tension or pressure may exceed its limit.
    """

    glide: float = 4.0
    rest: float = 1.5
    agree: float = 0.06
    far: float = 0.20
    patience: float = 0.5
    blind: float = 1.0
    beyond: float = 0.05


@dataclass(eq=False)
class Tracked:
    """What a closed loop did; a row a sample. It is filled as the loop runs, so that what was done is there if it ends early.

    Attributes:
        reference: what was to be followed.
        rows: of the reference, one a sample.
        time: of the samples since the loop was closed, in s.
        points: tracked, (points, 3) in m each; NaN where lost.
        truth: true tip, (3,) in m each, where the rig knows it; else NaN.
        commands: as sent.
        measured: pressures and tensions (2 · actuators,) where the rig measures both, else NaN.
        steps: of the predictive controller, one a sample; empty for others.
        seconds: that the controller took, one a sample.
        end: how it ended.
        message: more about it.
    """

    reference: Reference
    rows: list[int] = field(default_factory=list)
    time: list[float] = field(default_factory=list)
    points: list[np.ndarray] = field(default_factory=list)
    truth: list[np.ndarray] = field(default_factory=list)
    commands: list[Command] = field(default_factory=list)
    measured: list[np.ndarray] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    end: End = End.DONE
    message: str = ""
    fallbacks: dict[str, int] = field(default_factory=dict)

    @property
    def targets(self) -> np.ndarray:
        """Of the tip, (samples, 3) in m."""
        return self.reference.tips[np.array(self.rows, dtype=int)]

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


def _still(stage: str, done: float, of: float) -> None:
    pass


def track(
    rig: Rig, controller: Controller, robot: Robot, guard: Guard | None = None, show: Show = _still, look: Look | None = None,
    keep: Tracked | None = None,
) -> Tracked:  # fmt: skip
    """Follow a controller's reference on a rig, which is stopped at the end whatever happens.

    A rig of virtual time rests from the start where the controller wants it; any other is taken there slowly first, rests, and is
    refused if the tracked points are not where the model has them.

    Args:
        rig: any; it is entered and left here.
        controller: with its reference.
        robot: its limits.
        guard: when to stop.
        show: progress.
        look: a view.
        keep: filled, instead of a new one, so that a caller has what was done whatever is raised.

    Raises:
        InputError: a rig that does not fit the robot, or that disagrees with the model before the loop is closed.
    """
    guard, done = guard or Guard(), keep or Tracked(controller.reference)
    with rig:
        try:
            first = _prepared(rig, controller, robot, guard, show)
            _closed(rig, controller, robot, guard, show, look, done, first)
        except KeyboardInterrupt:
            done.end, done.message = End.INTERRUPTED, "interrupted by the user"
        except EOFError as error:
            done.end, done.message = End.OVER, str(error)
        finally:
            done.fallbacks = dict(getattr(controller, "fallbacks", {}))
    return done


def _prepared(rig: Rig, controller: Controller, robot: Robot, guard: Guard, show: Show) -> Sample:
    """The first sample, with the robot at rest where the controller starts."""
    start = controller.start()
    check_command(start, robot)
    rests = isinstance(rig, Virtual) or guard.glide <= 0
    rig.apply(start if rests else _part(start, 0.0))
    sample = rig.read()
    expected = controller.reference.equilibria[0].points
    if sample.points.shape != expected.shape:
        raise InputError(f"the rig gives {len(sample.points)} points, the robot has {len(expected)}; another robot?")
    if rests:
        return sample
    began, whole = sample.time, guard.glide + guard.rest
    missed: list[float] = []
    while sample.time - began < whole:
        passed = sample.time - began
        rig.apply(_part(start, float(rising(np.array(passed / guard.glide)))))
        show("to the start", passed, whole)
        sample = rig.read()
        if passed > guard.glide + guard.rest / 2:
            missed.append(float(np.nanmean(np.linalg.norm(sample.points - expected, axis=1))))
    miss = float(np.nanmedian(missed)) if np.isfinite(missed).any() else np.inf
    if not miss <= guard.agree:
        saw = f"the tracked points miss the model's by {1e3 * miss:.0f} mm" if np.isfinite(miss) else "the tracker sees nothing"
        raise InputError(
            f"at the start {saw}; valid: at most {1e3 * guard.agree:.0f} mm. Is the tracker registered (tepm hw calibrate base)?"
        )
    return sample


def _part(command: Command, part: float) -> Command:
    return Command(part * command.pressures, part * command.tensions * command.enabled, command.enabled)


def _closed(
    rig: Rig, controller: Controller, robot: Robot, guard: Guard, show: Show, look: Look | None, done: Tracked, sample: Sample
) -> None:
    """Samples and commands in turns until the reference ends or the guard stops it."""
    reference, zero, row = controller.reference, sample.time, -1
    limits = robot.input_max * (1 + guard.beyond)
    seen = near = sample.time
    while True:
        now = round((sample.time - zero) / reference.period)
        if now >= len(reference):
            return
        if now > row:  # a rig may be faster than the control period
            row = now
            began = time.perf_counter()
            command = controller.command(sample)
            seconds = time.perf_counter() - began
            rig.apply(command)
            _note(done, rig, sample, sample.time - zero, row, command, seconds, controller)
            show("tracking", sample.time - zero, reference.duration)
            if look:
                look(sample, reference.tips[row])
        tracked = np.isfinite(sample.points).all(axis=1)
        seen = sample.time if tracked.any() else seen
        off = np.linalg.norm(sample.points[-1] - reference.tips[row])
        near = near if off > guard.far else sample.time
        measured = _measured(sample, len(limits))
        if sample.time - seen > guard.blind:
            done.end, done.message = End.BLIND, f"no tracked point for {guard.blind:g} s"
        elif sample.time - near > guard.patience:
            done.end, done.message = End.DISAGREED, f"the tip was more than {1e3 * guard.far:.0f} mm off for {guard.patience:g} s"
        elif (measured > limits).any():
            done.end, done.message = (
                End.LIMIT,
                f"input {int(np.argmax(measured > limits)) + 1} is at {np.nanmax(measured / limits):.2f} of it",
            )
        if done.end is not End.DONE:
            return
        sample = rig.read()


def _measured(sample: Sample, count: int) -> np.ndarray:
    if sample.pressures is None or sample.tensions is None:
        return np.full(count, np.nan)
    return np.concatenate([sample.pressures, sample.tensions])


def _note(
    done: Tracked, rig: Rig, sample: Sample, passed: float, row: int, command: Command, seconds: float, controller: Controller
) -> None:
    true = getattr(rig, "true_points", None)
    done.rows.append(row)
    done.time.append(passed)
    done.points.append(sample.points)
    done.truth.append(np.full(3, np.nan) if true is None else np.array(true[-1]))
    done.commands.append(command)
    done.measured.append(_measured(sample, 2 * len(command.pressures)))
    done.seconds.append(seconds)
    if isinstance(controller, Mpc) and controller.last is not None:
        done.steps.append(controller.last)

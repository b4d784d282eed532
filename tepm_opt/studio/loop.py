"""A closed loop on a simulated rig in real time, which may be pushed and stopped while it runs."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tepm_opt.errors import InputError
from tepm_opt.hw.guard import Stopped
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import DEFAULT, builtin_rigs, load_rig_file
from tepm_opt.hw.simulation.scaling import scale_rig
from tepm_opt.jobs.closed_loop import ClosedLoop, LoopSetup
from tepm_opt.jobs.course import Course, whole_reference
from tepm_opt.jobs.mpc import run_closed_loop
from tepm_opt.models.channels import channels_of
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.robot import Robot
from tepm_opt.outcome import Ending
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.planning.trajectories import Trajectory

SIM = "sim"


@dataclass(frozen=True, eq=False)
class Moment:
    """A rig at a sample.

    Attributes:
        time: of the sample in s.
        points: tracked, (points, 3) in m in G; NaN where lost.
        inputs: commanded, (2 · modules · actuators,) in Pa and N.
        target: of the tip, (3,) in m.
        nodes: true ones in G, (n + 1, actuators, 3) in m; None where the rig is no simulation.
        force: with which the tip is pushed, (3,) in N.
    """

    time: float
    points: np.ndarray
    inputs: np.ndarray
    target: np.ndarray
    nodes: np.ndarray | None
    force: np.ndarray

    def __repr__(self) -> str:
        return f"Moment({self.time:.2f} s, tip {1e3 * self.error:.1f} mm from its target)"

    @property
    def tip(self) -> np.ndarray:
        """The true tip where it is known, else the tracked one, (3,) in m."""
        return self.points[-1] if self.nodes is None else self.nodes[-1].mean(axis=0)

    @property
    def error(self) -> float:
        """Distance of the tip from its target in m."""
        return float(np.linalg.norm(self.tip - self.target))

    @staticmethod
    def from_sample(
        sample: Sample, command: Command, target: np.ndarray, nodes: np.ndarray | None, force: np.ndarray | None = None
    ) -> Moment:
        """Build the moment of a sample of a rig.

        Args:
            sample: as read.
            command: given then.
            target: of the tip, (3,) in m.
            nodes: true ones where they are known.
            force: on the tip in N; none where absent.
        """
        inputs = np.concatenate([command.pressures, command.tensions])
        return Moment(sample.time, sample.points, inputs, target, nodes, np.zeros(3) if force is None else force)


class Pace:
    """Waiting that keeps virtual time beside the clock; time that was lost is made up for, up to a tenth of a second.

    Args:
        sleep: how to wait, in s.
        clock: in s.
    """

    def __init__(self, sleep: Callable[[float], None] = time.sleep, clock: Callable[[], float] = time.monotonic) -> None:
        self._sleep, self._clock = sleep, clock
        self._due = clock()

    def __call__(self, seconds: float) -> None:
        """Wait until so much time has passed since the last call."""
        now = self._clock()
        self._due = max(self._due + seconds, now - 0.1)
        if self._due > now:
            self._sleep(self._due - now)


def simulated_rig(text: str = SIM, wait: Callable[[float], None] | None = None, robot: Robot | None = None) -> SimulatedRig:
    """The simulated rig that a text names.

    Args:
        text: "sim", or "sim:FILE" with a rig file or the name of a built-in one.
        wait: called with the time in s until each next sample; real time where absent.
        robot: to which built-in rigs are scaled; their own where absent.

    Raises:
        InputError: another kind of rig, or no such file.
    """
    kind, colon, name = text.partition(":")
    if kind != SIM or bool(colon) != bool(name):
        raise InputError(f"--rig {text!r}: the studio moves simulated rigs only; valid: {SIM}, {SIM}:FILE")
    name = name or DEFAULT
    file = load_rig_file(name)
    return SimulatedRig(scale_rig(file, robot) if robot and name in builtin_rigs() else file, wait or Pace())


class LiveLoop:
    """A closed loop that somebody watches.

    Args:
        model: the controller's.
        rig: simulated.
        show: given every moment, in the loop's thread.

    Raises:
        InputError: the rig is not simulated, or has another robot.
    """

    def __init__(self, model: CompiledModel, rig: SimulatedRig, show: Callable[[Moment], None]) -> None:
        if not isinstance(rig, SimulatedRig):
            raise InputError(f"{rig!r} is not simulated; the studio moves nothing else")
        if channels_of(rig.robot) != channels_of(model.robot):
            raise InputError(
                f"the rig's robot is {rig.robot.name!r}, the model's {model.robot.name!r}; name a rig that has it (--rig sim:FILE)"
            )
        self._model, self._rig, self._show = model, rig, show
        self._stopped = threading.Event()
        self._asked: tuple[np.ndarray, float] | None = None  # force, for how long
        self._force, self._until = np.zeros(3), -np.inf

    def stop(self) -> None:
        """End the loop at its next sample."""
        self._stopped.set()

    def push(self, force: np.ndarray, seconds: float) -> None:
        """Push the tip from the next sample on.

        Args:
            force: in G, (3,) in N.
            seconds: for how long.
        """
        self._asked = np.asarray(force, dtype=float), seconds

    def run(self, trajectory: Trajectory, course: Course, controller: str, progress: Progress = silent) -> ClosedLoop:
        """Follow a trajectory until its end or until `stop`.

        Args:
            trajectory: targets.
            course: how it is driven.
            controller: name of a kind of controller.
            progress: told what is done.

        Raises:
            InputError: a trajectory out of reach.
            Stopped: before the loop was closed.
        """

        def report_unless_stopped(stage: str, done: float, of: float) -> None:
            self._unless_stopped()
            progress(stage, done, of)

        reference = whole_reference(self._model, trajectory, course, progress=report_unless_stopped)
        return run_closed_loop(
            self._model, reference, self._rig, LoopSetup(controller, SIM), progress=report_unless_stopped, observer=self._observe_sample
        )

    def _unless_stopped(self) -> None:
        if self._stopped.is_set():
            raise Stopped(Ending.INTERRUPTED, "stopped on the page")

    def _observe_sample(self, sample: Sample, command: Command, target: np.ndarray) -> None:
        self._unless_stopped()
        if self._asked is not None:
            (self._force, seconds), self._asked = self._asked, None
            self._until = sample.time + seconds
            self._rig.push(self._force)
        elif sample.time > self._until and self._force.any():
            self._force = np.zeros(3)
            self._rig.push(self._force)
        self._show(Moment.from_sample(sample, command, target, self._rig.true_nodes, self._force))

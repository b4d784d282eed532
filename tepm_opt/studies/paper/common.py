"""Shared parts of the experiments: rigs with the noise of a run, playing set points, means."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import RigFile
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot
from tepm_opt.progress import Progress, silent

AHEAD = 25  # samples between two tellings of progress
SWAY = 1.1  # s, period of the slowest sway: what is averaged over it does not see it


class Clock:
    """Virtual time that experiments take, told as progress.

    Attributes:
        passed: how much of it has passed, in s.
    """

    def __init__(self, progress: Progress = silent, of: float = 0.0) -> None:
        """A clock at zero.

        Args:
            progress: told the experiment and the virtual time that has passed since the first one began.
            of: virtual time of all experiments in s; 0 where nobody knows.
        """
        self.passed = 0.0
        self._progress, self._of, self._stage = progress, of, ""

    def begin_experiment(self, stage: str, passed: float) -> None:
        """Begin an experiment at a time in s, whatever those before took."""
        self._stage = stage
        self.advance(passed - self.passed)

    def advance(self, seconds: float) -> None:
        """Let some s pass."""
        self.passed += seconds
        self._progress(self._stage, self.passed, self._of)

    def part(self) -> Progress:
        """Progress of a part that begins now and tells its own time in s."""
        start = self.passed

        def progress(stage: str, done: float, of: float) -> None:
            self.advance(start + done - self.passed)

        return progress


@dataclass(frozen=True, eq=False)
class Setting:
    """Model, prototype and repetitions that all experiments start from.

    Attributes:
        model: nominal, compiled.
        rig: file of the virtual prototype.
        runs: repetitions of an experiment (the paper's are 3).
        clock: told the virtual time that passes.
        workers: processes for what takes longest; results do not depend on it.
    """

    model: CompiledModel
    rig: RigFile
    runs: int = 3
    clock: Clock = field(default_factory=Clock)
    workers: int = 1

    @property
    def repeated(self) -> str:
        """Number of runs, in words."""
        return f"{self.runs} run{'s' if self.runs > 1 else ''}"

    def prototype(self, noise: int) -> SimulatedRig:
        """The virtual prototype with the noise of one run."""
        rig = SimulatedRig(self.rig)
        rig.reseed(noise)
        return rig

    def twin(self) -> SimulatedRig:
        """The model in motion: the same network, no imperfections, perfect devices."""
        tracker = {"rate_hz": self.rig.tracker.rate_hz}
        return SimulatedRig(RigFile.model_validate({"name": "model", "robot": self.rig.robot, "tracker": tracker}))


def inputs_of(robot: Robot, pressures: dict[str, float] | None = None, tensions: dict[str, float] | None = None) -> np.ndarray:
    """u with pressures in Pa and tensions in N by actuator, zero elsewhere."""
    names = Layout.from_robot(robot).actuator_names
    inputs = np.zeros(2 * len(names))
    for name, value in (pressures or {}).items():
        inputs[names.index(name)] = value
    for name, value in (tensions or {}).items():
        inputs[len(names) + names.index(name)] = value
    return inputs


def play(rig: SimulatedRig, setpoints: SetPoints, until: float, progress: Progress = silent) -> tuple[np.ndarray, np.ndarray]:
    """Play set points that are linear between their rows, from rest under the first.

    Args:
        rig: which; at its start.
        setpoints: to play.
        until: time of the last sample in s.
        progress: told the time in s that has passed.

    Returns:
        Time in s, (samples,), and reference points in m in G, (samples, points, 3).
    """
    rig.schedule(setpoints)
    samples = [rig.read()]
    while (left := until - samples[-1].time) > 1e-9:
        samples += rig.read_many(min(max(int(left * rig.file.tracker.rate_hz), 1), AHEAD))
        progress("set points", samples[-1].time, until)
    return np.array([sample.time for sample in samples]), np.array([sample.points for sample in samples])


def ramp(inputs: np.ndarray, rise: float, start: np.ndarray | None = None, force: np.ndarray | None = None) -> SetPoints:
    """Ramp from inputs without load to inputs with a tip force.

    Args:
        inputs: u at the end, (2 · modules · actuators,) in Pa and N.
        rise: time that it takes in s.
        start: u at the beginning, in the same order; zero where absent.
        force: tip force at the end in G, (3,) in N; zero where absent.
    """
    first = np.zeros_like(inputs) if start is None else start
    tip = np.zeros(3) if force is None else force
    return SetPoints(np.array([0.0, rise]), np.array([first, inputs]), np.array([np.zeros(3), tip]))


def middle(values: list[float]) -> int:
    """Find the index of the run with the middle value (of an even number the lower one)."""
    return int(np.argsort(values, kind="stable")[(len(values) - 1) // 2])

"""What the experiments share: rigs with the noise of a run, playing set points, means."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import RigFile
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot

SWAY = 1.1  # s, period of the slowest sway: what is averaged over it does not see it
Show = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class Setting:
    """What all experiments start from.

    Attributes:
        model: nominal, compiled.
        rig: file of the virtual prototype.
        runs: repetitions of an experiment (the paper's are 3).
        show: called with the virtual time in s that has passed since the last call; for progress.
        workers: processes for what takes longest; results do not depend on it.
    """

    model: CompiledModel
    rig: RigFile
    runs: int = 3
    show: Show = lambda _: None
    workers: int = 1

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
    names = Layout.of(robot).actuator_names
    inputs = np.zeros(2 * len(names))
    for name, value in (pressures or {}).items():
        inputs[names.index(name)] = value
    for name, value in (tensions or {}).items():
        inputs[len(names) + names.index(name)] = value
    return inputs


def play(rig: SimulatedRig, setpoints: SetPoints, until: float, show: Show = lambda _: None) -> tuple[np.ndarray, np.ndarray]:
    """Play set points that are linear between their rows, from rest under the first; time (samples,), points (samples, points, 3)."""
    rig.schedule(setpoints)
    times, points = [], []
    before = 0.0
    while not times or times[-1] < until - 1e-9:
        sample = rig.read()
        times.append(sample.time)
        points.append(sample.points)
        show(sample.time - before)
        before = sample.time
    return np.array(times), np.array(points)


def ramp(inputs: np.ndarray, rise: float, start: np.ndarray | None = None, force: np.ndarray | None = None) -> SetPoints:
    """From `start` (zero where absent) and no load to inputs u and a tip force (3,), in `rise` s."""
    first = np.zeros_like(inputs) if start is None else start
    tip = np.zeros(3) if force is None else force
    return SetPoints(np.array([0.0, rise]), np.array([first, inputs]), np.array([np.zeros(3), tip]))


def middle(values: list[float]) -> int:
    """Which of some runs has the middle value (of an even number the lower one)."""
    return int(np.argsort(values, kind="stable")[(len(values) - 1) // 2])

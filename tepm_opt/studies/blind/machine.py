"""A machine that is not the model: the simulated rig with what it hides, played through the runs of an experiment."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import reduce
from typing import Any

import numpy as np

from tepm_opt.data.documents import validate
from tepm_opt.data.run import Run
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.hw.simulation.imperfections.base import Body
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import RigFile
from tepm_opt.models.robot import Robot
from tepm_opt.studies.blind.excitation import RATE, Excitation

STEP = 1 / 2800  # s, or less where the robot does not bear it

Commands = Callable[[SetPoints], SetPoints]
"""Change of commands and known forces before they act."""
Sight = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Change of points (rows, points, 3) in m, at times (rows,) in s, before they are recorded."""
Build = Callable[[Any, Body], None]
"""Changes an engine's document of a robot (`mujoco.MjSpec`, `RodDesign`) and its network in numbers."""


@dataclass(frozen=True)
class Deviation:
    """Deviation of a machine from its robot file.

    Attributes:
        imperfections: of the rig, as a rig file has them.
        factors: true parameters over the robot file's.
        before, after: what acts on the commands and on the points besides the rig's imperfections.
        build: what changes an engine's document of the machine, of the families `engine` and `rod` only.
    """

    imperfections: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    factors: Mapping[str, float] = field(default_factory=dict)
    before: Commands | None = None
    after: Sight | None = None
    build: Build | None = None

    def __add__(self, other: Deviation) -> Deviation:
        """Both at once: factors multiply, the other's changes act after these."""
        names = self.factors.keys() | other.factors.keys()
        factors = {name: self.factors.get(name, 1.0) * other.factors.get(name, 1.0) for name in sorted(names)}
        before, after, first, last = self.before, self.after, other.before, other.after
        build, more = self.build, other.build
        return Deviation(
            {**self.imperfections, **other.imperfections},
            factors,
            before if first is None else first if before is None else lambda asked: first(before(asked)),
            after if last is None else last if after is None else lambda time, points: last(time, after(time, points)),
            build if more is None else more if build is None else lambda spec, body: (build(spec, body), more(spec, body))[0],
        )


def combine_deviations(deviations: Iterable[Deviation]) -> Deviation:
    """Combine deviations into one."""
    return reduce(Deviation.__add__, deviations, Deviation())


def rig_file(robot: Robot, deviation: Deviation, noise: float, seed: int = 0, rate: float = RATE) -> RigFile:
    """The rig of a machine: perfect devices but for the tracker's noise.

    Args:
        robot: as its file says; built in.
        deviation: what differs.
        noise: of the tracker, 1 sigma per axis in m.
        seed: of what is drawn once.
        rate: of the tracker in Hz.

    Raises:
        InputError: a value that no rig has.
    """
    return validate(
        RigFile,
        {
            "name": "hidden",
            "robot": robot.name,
            "seed": seed,
            "simulation": {"step_s": STEP},
            "parameter_factors": dict(deviation.factors),
            "tracker": {"rate_hz": rate, "noise_rms_m": np.sqrt(3) * noise},
            "imperfections": dict(deviation.imperfections),
        },
        "hidden",
    )


def simulate_run(file: RigFile, deviation: Deviation, run: Excitation, noise: int) -> Run:
    """Simulate a run as it is recorded: inputs as commanded, points as measured, with noise behind all that acts on them.

    Args:
        file: see `rig_file`.
        deviation: what acts on commands and points.
        run: what is commanded.
        noise: seed of the tracker's.

    Raises:
        NoEquilibriumError, Diverged: the machine does not bear it.
    """
    asked = run.setpoints
    acting = asked if deviation.before is None else deviation.before(asked)
    points = _track_points(file, acting, noise, run.began)
    if deviation.after is not None:
        clear = points
        if file.tracker.noise_rms_m:
            clear = _track_points(
                file.model_copy(update={"tracker": file.tracker.model_copy(update={"noise_rms_m": 0.0})}), acting, noise, run.began
            )
        points = deviation.after(asked.time, clear) + (points - clear)
    return Run(run.file, run.role, asked.time, asked.inputs, asked.tip_force, points, began=run.began)


def _track_points(file: RigFile, acting: SetPoints, noise: int, began: float) -> np.ndarray:
    """Simulate the rig and return the points that its tracker sees, (rows, points, 3) in m."""
    rig = SimulatedRig(file, watched=False)
    rig.reseed(noise, began)
    rig.schedule(acting)
    points = np.array([sample.points for sample in rig.read_many(len(acting.time))])
    if len(points) < len(acting.time):
        raise rig.machine.make_divergence_error(rig.machine.now)
    return points

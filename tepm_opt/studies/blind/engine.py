"""Trials in which another engine moves the robot and holds what is hidden: MuJoCo a network (`engine`), PyElastica a rod (`rod`)."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from tepm_opt.data.run import Run
from tepm_opt.models.robot import Robot
from tepm_opt.studies.blind import engine_causes, rod_causes
from tepm_opt.studies.blind.causes import Cause, Form
from tepm_opt.studies.blind.excitation import Excitation
from tepm_opt.studies.blind.hidden import Experiment, Hidden
from tepm_opt.studies.blind.machine import Deviation
from tepm_opt.studies.blind.mujoco_world import MujocoWorld
from tepm_opt.studies.blind.rod_world import RodWorld
from tepm_opt.studies.blind.sizes import UNBEARABLE, Pilot
from tepm_opt.studies.blind.world import World, record_runs

PARTS = {"null": 0.25, "foreign": 0.2, "pair": 0.15}  # the rest of the trials hides one cause that has a name
MISFIT = (2.0, 20.0)  # times the noise, of each cause
TOO_SMALL = 0.7  # times the noise, of a cause that is not worth hiding
ATTEMPTS = 3  # simulations for the size of one cause
NEAR = 1.6  # ratio to the misfit wanted that is near enough


@dataclass(frozen=True)
class Engine:
    """An engine and its causes.

    Attributes:
        title: for tables.
        world: makes a robot in it.
        known, unknown: causes that have a name in the library of effects, and others.
        seconds: shortest and longest run.
    """

    title: str
    world: Callable[[Robot, Deviation], World]
    known: Mapping[str, Cause]
    unknown: Mapping[str, Cause]
    seconds: tuple[float, float]

    def simulate(self, robot: Robot, machine: Deviation, runs: Sequence[Excitation]) -> list[np.ndarray]:
        """Points of runs without noise, each (rows, points, 3) in m.

        Raises:
            NoEquilibriumError, Diverged: the machine does not bear it.
        """
        return record_runs(self.world(robot, machine), machine, runs)

    def draw_experiment(self, random: np.random.Generator, draw_pilot: Callable[[tuple[float, float]], Pilot]) -> Experiment:
        """A robot in the engine with nothing, one or two known causes, or an unknown one.

        Args:
            random: generator of the trial.
            draw_pilot: draws the machine and its runs, of lengths between two in s.
        """
        pilot, drawn = draw_pilot(self.seconds), random.uniform()
        if drawn < PARTS["null"]:
            return Experiment(pilot, "null")
        foreign = drawn < PARTS["null"] + PARTS["foreign"]
        count = 2 if drawn > 1 - PARTS["pair"] else 1
        causes = self._choose(random, pilot, self.unknown if foreign else self.known, count)
        return Experiment(pilot, "foreign" if foreign else "lib", causes)

    def _choose(self, random: np.random.Generator, pilot: Pilot, table: Mapping[str, Cause], count: int) -> tuple[Hidden, ...]:
        """Different causes with drawn misfits; others where the engine's robot does not bear one or it changes too little."""
        plain = self._simulate_fit(pilot, Deviation())
        found: list[Hidden] = []
        for key in random.permutation(sorted(table)):
            wanted = float(np.exp(random.uniform(*np.log(MISFIT))))
            form = table[str(key)](random)
            size, misfit = self._find_size(pilot, plain, form, wanted)
            if misfit >= TOO_SMALL:
                found.append(Hidden(str(key), form, size, misfit))
            if len(found) == count:
                break
        return tuple(found)

    def _find_size(self, pilot: Pilot, plain: np.ndarray, form: Form, wanted: float) -> tuple[float, float]:
        """Size of a cause with about the misfit wanted, and its misfit over the noise; 0 where no size was borne.

        Args:
            pilot: of the machine without it.
            plain: points of the runs to fit to without it, (coordinates,) in m.
            form: of the cause.
            wanted: misfit over the noise.
        """
        size, low, high, best = form.usual, form.low, form.high, (form.usual, 0.0)
        for _ in range(ATTEMPTS):
            try:
                misfit = _misfit(pilot, plain, self._simulate_fit(pilot, form.at(size)))
            except UNBEARABLE:
                high, size = size, float(np.sqrt(low * size))
                continue
            ratio = wanted / max(misfit, 1e-3 * wanted)
            if not best[1] or abs(np.log(ratio)) < abs(np.log(wanted / best[1])):
                best = size, misfit
            low, high = (size, high) if ratio > 1 else (low, size)
            if 1 / NEAR < ratio < NEAR or high / low < 1 + 1e-6:
                break
            size = size * ratio if low < size * ratio < high else float(np.sqrt(low * high))  # stops and walls are not linear
        return best

    def _simulate_fit(self, pilot: Pilot, change: Deviation) -> np.ndarray:
        """Points of the runs to fit to, one after the other, (coordinates,) in m."""
        runs = [run for run in pilot.runs if run.role == "fit"]
        return np.concatenate([points.ravel() for points in self.simulate(pilot.robot, pilot.machine + change, runs)])

    def record_run(self, pilot: Pilot, machine: Deviation, run: Excitation, noise: str) -> Run:
        """A run as a tracker records it, with noise.

        Args:
            pilot: robot and noise.
            machine: factors, and what is hidden.
            run: commands.
            noise: what the noise is drawn from.

        Raises:
            NoEquilibriumError, Diverged: the machine does not bear it.
        """
        asked, random = run.setpoints, np.random.default_rng(zlib.crc32(noise.encode()))
        (points,) = self.simulate(pilot.robot, machine, [run])
        points = points + pilot.noise * random.normal(size=points.shape)
        return Run(run.file, run.role, asked.time, asked.inputs, asked.tip_force, points, began=run.began)


def _misfit(pilot: Pilot, plain: np.ndarray, changed: np.ndarray) -> float:
    """Root mean square of a change that parameters within their priors do not take up to first order, over the noise."""
    factors = pilot.machine.factors
    now = np.array([(factors.get(name, 1.0) - 1) / width for name, width in pilot.robot.priors.items()])
    step = lsq_linear(pilot.by, changed - plain, (-1 - now, np.maximum(1 - now, -1 - now + 1e-9))).x
    return float(np.sqrt(np.mean((changed - plain - pilot.by @ step) ** 2))) / pilot.noise


MUJOCO = Engine("MuJoCo", MujocoWorld, engine_causes.KNOWN, engine_causes.UNKNOWN, (5.0, 8.0))  # it takes some 0.4 s for a run
ROD = Engine("Cosserat rod", RodWorld, rod_causes.KNOWN, rod_causes.UNKNOWN, (5.0, 6.0))  # it takes about a run's own length
ENGINES = {"engine": MUJOCO, "rod": ROD}
"""By family."""

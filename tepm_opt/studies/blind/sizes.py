"""Sizes of causes by the misfit they leave: pilot simulations without noise, with and without the cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from tepm_opt.data.run import Role
from tepm_opt.errors import InputError
from tepm_opt.hw.simulation.equilibrium import NoEquilibriumError
from tepm_opt.hw.simulation.machine import Diverged
from tepm_opt.models.robot import Robot
from tepm_opt.studies.blind.causes import Form
from tepm_opt.studies.blind.excitation import RATE, Excitation
from tepm_opt.studies.blind.machine import Deviation, rig_file, simulate_run

UNBEARABLE = (NoEquilibriumError, Diverged, InputError)
"""Exceptions of a machine that does not bear its runs."""
PART = 0.25  # of a prior's width, of the differences by parameters
NEAR = 0.25  # of the misfit asked for: near enough
PILOTS = 6  # most for one cause
RECALIBRATIONS = 12  # most steps for one size, each a simulation
WORTH = 0.03  # of the misfit, that a step must promise
TINY = 1e-9


@dataclass(frozen=True, eq=False)
class Pilot:
    """Noise-free runs to fit to of a machine without a cause, and what its parameters may do to them within their priors.

    Attributes:
        robot: as its file says.
        machine: without the cause.
        runs: all of the trial.
        noise: 1 sigma per axis in m.
        rate: of the tracker in Hz.
        points: of the runs to fit to, one after the other, (coordinates,) in m.
        by: derivatives of the points by parameters over half the width of their priors, (coordinates, parameters) in m.
    """

    robot: Robot
    machine: Deviation
    runs: Sequence[Excitation]
    noise: float
    rate: float
    points: np.ndarray
    by: np.ndarray

    @staticmethod
    def from_simulation(robot: Robot, machine: Deviation, runs: Sequence[Excitation], noise: float, rate: float = RATE) -> Pilot:
        """Simulate the runs, and those to fit to again with each parameter changed.

        Args:
            robot: as its file says.
            machine: without the cause.
            runs: of the trial.
            noise: 1 sigma per axis in m.
            rate: of the tracker in Hz.

        Raises:
            NoEquilibriumError, Diverged: the machine does not bear the runs.
        """
        points = simulate_points(robot, machine, runs, rate)
        simulate_points(robot, machine, runs, rate, "validation")  # it has to bear them
        return Pilot(robot, machine, runs, noise, rate, points, _slopes(robot, machine, runs, rate, points))

    def misfit(self, form: Form, size: float) -> float:
        """Root mean square of what a cause changes, less what recalibration within the priors takes up, over the noise.

        Recalibration is Gauss and Newton's, with derivatives that Broyden's rule keeps up to date (Mathematics of Computation 19, 1965);
        once it promises no more, new ones are asked.

        Raises:
            NoEquilibriumError, Diverged: the machine does not bear the runs with it.
        """
        measured = simulate_points(self.robot, self.machine + form.at(size), self.runs, self.rate)
        now = np.array([(self.machine.factors.get(name, 1.0) - 1) / width for name, width in self.robot.priors.items()])
        at, points, by, least, renewed = now, self.points, self.by, np.inf, False
        for _ in range(RECALIBRATIONS):
            left = measured - points
            least = min(least, _rms(left))
            step = lsq_linear(by, left, (-1 - at, np.maximum(1 - at, -1 - at + TINY))).x
            if _rms(left - by @ step) >= (1 - WORTH) * least:
                if renewed or by is self.by:
                    break
                by, renewed = _slopes(self.robot, self.machine + self._change_parameters(now, at), self.runs, self.rate, points), True
                continue
            at = at + step
            moved = simulate_points(self.robot, self.machine + self._change_parameters(now, at), self.runs, self.rate)
            by = by + np.outer(moved - points - by @ step, step) / (step @ step)
            points = moved
        return least / self.noise

    def _change_parameters(self, now: np.ndarray, to: np.ndarray) -> Deviation:
        """Parameters at `to` instead of `now`, in widths of their priors."""
        widths = self.robot.priors.items()
        return Deviation(factors={name: (1 + width * b) / (1 + width * a) for (name, width), a, b in zip(widths, now, to, strict=True)})

    def find_size(self, form: Form, wanted: float) -> tuple[float, float]:
        """Find the size of a cause at which the misfit is about as wanted, as near as its limits and the machine let it; with its misfit.

        A misfit of 0 says that no size was borne.
        """
        size, low, high = form.usual, form.low, form.high
        best, last = (size, 0.0), None
        for _ in range(PILOTS):
            try:
                found = self.misfit(form, size)
            except UNBEARABLE:
                high = size
                size = np.sqrt(low * high)
                continue
            if found > 0 and (not best[1] or abs(np.log(found / wanted)) < abs(np.log(best[1] / wanted))):
                best = size, found
            power = 1.0
            if last is not None and found > 0 and last[1] > 0 and last[0] != size:
                power = float(np.clip(np.log(found / last[1]) / np.log(size / last[0]), 0.3, 3.0))
            last = size, found
            following = float(np.clip(size * (wanted / max(found, 1e-9 * wanted)) ** (1 / power), low, high))
            if abs(found / wanted - 1) < NEAR or abs(following / size - 1) < 1e-6:
                break
            size = following
        return best


def simulate_points(robot: Robot, machine: Deviation, runs: Sequence[Excitation], rate: float, role: Role = "fit") -> np.ndarray:
    """Simulate points without noise of the runs of a role, one after the other, (coordinates,) in m.

    Args:
        robot: as its file says.
        machine: what differs.
        runs: of a trial.
        rate: of the tracker in Hz.
        role: of the runs to simulate.

    Raises:
        NoEquilibriumError, Diverged: the machine does not bear the runs.
    """
    file = rig_file(robot, machine, 0.0, rate=rate)
    return np.concatenate([np.empty(0), *(simulate_run(file, machine, run, 0).points.ravel() for run in runs if run.role == role)])


def _slopes(robot: Robot, machine: Deviation, runs: Sequence[Excitation], rate: float, points: np.ndarray) -> np.ndarray:
    """Derivatives of points by parameters over half the width of their priors, (coordinates, parameters) in m.

    Args:
        robot: as its file says.
        machine: that the points are of.
        runs: of a trial.
        rate: of the tracker in Hz.
        points: of the runs to fit to, (coordinates,) in m.
    """
    changes = [Deviation(factors={name: 1 + PART * width}) for name, width in robot.priors.items()]
    by = [(simulate_points(robot, machine + change, runs, rate) - points) / PART for change in changes]
    return np.array(by).reshape(len(by), -1).T


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))

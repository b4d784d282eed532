"""From commands to the actuators' axial forces: regulators, tendon motors and the imperfections between them and the muscle."""

from __future__ import annotations

import numpy as np

from tepm_opt.hw.simulation.devices import on_grid
from tepm_opt.hw.simulation.rigfile import RigFile
from tepm_opt.models.robot import Robot


class ActuationDynamics:
    """States of everything between the commands and F_a = p A − λ, Eq. (3).

    A command is [pressures, tensions, ENA], (3 · actuators,) in Pa, N and 0 or 1, with all modules' actuators.

    Attributes:
        pressure: in the muscles behind the regulators, (actuators,) in Pa: what a pressure monitor measures.
        tension: at the motors, (actuators,) in N: what a dynamometer measures.
        regulators, muscles, tendons: stages of the pressures, of the pressures behind the monitors, and of the tensions, in their order.
        area: A in m².
        grids: of the pressures in Pa and the tensions in N, 0 where continuous.
        rate: at which tensions change at most in N/s.
        uses_lengths: whether the tension depends on the actuators' lengths or their rates.
        direct: whether forces follow the commands without any state or bend.
    """

    def __init__(self, file: RigFile, robot: Robot) -> None:
        active = file.imperfections.active.values()
        stages = [(item, stage) for item in active if (stage := item.pressure_stage(robot)) is not None]
        self.regulators = [stage for item, stage in stages if item.of_regulators]
        self.muscles = [stage for item, stage in stages if not item.of_regulators]
        self.tendons = [stage for item in active if (stage := item.tension_stage(robot)) is not None]
        self.area = robot.parameters.A
        self.grids = (file.regulator.step_of(robot), file.stepper.step_of(robot))
        self.rate = file.stepper.rate_limit_N_per_s or np.inf
        self.pressure = self.tension = np.zeros(robot.modules * robot.actuators)
        self._effective = self.pressure
        self.uses_lengths = bool(self.tendons)
        self.direct = not (stages or self.tendons or any(self.grids) or np.isfinite(self.rate))

    def settle(self, command: np.ndarray) -> None:
        """Take the long-time state for a constant command."""
        pressure, tension, enabled = np.split(command, 3)
        self.pressure = on_grid(pressure, self.grids[0])
        for stage in self.regulators:
            self.pressure = stage.settle(self.pressure)
        self._effective = self.pressure
        for stage in self.muscles:
            self._effective = stage.settle(self._effective)
        self.tension = on_grid(tension, self.grids[1]) * enabled

    def force_at_rest(self, lengths: np.ndarray) -> np.ndarray:
        """F_a when settled and standing still at actuator lengths (…, actuators) in m, (…, actuators) in N."""
        tension = self.tension
        for stage in self.tendons:
            tension = stage.settle(tension, lengths)
        return self.area * self._effective - tension

    def step(self, command: np.ndarray, lengths: np.ndarray, rates: np.ndarray, duration: float) -> np.ndarray:
        """F_a at the start and the end of a tick, (2, actuators) in N.

        Args:
            command: at the start and the end, linear between, (2, 3 · actuators).
            lengths, rates: of the actuators at the start, (actuators,) in m and m/s.
            duration: of the tick in s.
        """
        count = len(self.tension)
        pressure, tension, enabled = command[:, :count], command[:, count : 2 * count], command[0, 2 * count :]
        pressure = self._quantise(pressure, self.grids[0])
        for stage in self.regulators:
            pressure = stage.step(pressure, duration)
        self.pressure = pressure[1]
        for stage in self.muscles:
            pressure = stage.step(pressure, duration)
        tension = self._wind(self._quantise(tension, self.grids[1]), enabled, duration)
        for stage in self.tendons:
            tension = stage.step(tension, lengths, rates, duration)
        return self.area * pressure - tension

    def _wind(self, goal: np.ndarray, enabled: np.ndarray, duration: float) -> np.ndarray:
        """Tension at the motors, (2, actuators) in N: limited in rate, released at once where disabled."""
        start, largest = self.tension * enabled, self.rate * duration
        if np.isinf(largest):
            out = goal * enabled
        else:
            change = np.minimum(np.maximum(goal[1] * enabled - start, -largest), largest)
            out = np.array([start, start + change])
        self.tension = out[1]
        return out

    @staticmethod
    def _quantise(values: np.ndarray, grid: float) -> np.ndarray:
        """Put set points on their grid, held for a tick, (2, actuators); unchanged where the grid is 0."""
        if grid == 0:
            return values
        held = on_grid((values[0] + values[1]) / 2, grid)
        return np.array([held, held])

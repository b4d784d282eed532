"""From Pa and N to what a board understands, and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tepm_opt.errors import InputError
from tepm_opt.hw.board.protocol import CHANNELS, DAC_CODES
from tepm_opt.models.hardware import COUNTS_PER_V, Hardware
from tepm_opt.models.robot import Robot


@dataclass(frozen=True, eq=False)
class Calibration:
    """Straight lines for every actuator; arrays are (actuators of all modules,).

    Attributes:
        codes, codes_zero: DAC codes a Pa, and at 0.
        monitor, monitor_zero: counts of the monitors a Pa, and at 0.
        counts, counts_zero: counts of the dynamometers a N, and at 0.
        steps, steps_mm: of the motors a N, and a mm of tendon.
    """

    codes: np.ndarray
    codes_zero: np.ndarray
    monitor: np.ndarray
    monitor_zero: np.ndarray
    counts: np.ndarray
    counts_zero: np.ndarray
    steps: np.ndarray
    steps_mm: np.ndarray

    @staticmethod
    def from_robot(robot: Robot) -> Calibration:
        """Read the calibration of a robot file.

        Raises:
            InputError: it has no `[hardware]`, more actuators than a board drives, or lists of another length.
        """
        count, hardware = robot.modules * robot.actuators, robot.hardware
        if hardware is None:
            raise InputError(f"robot {robot.name}: the file has no [hardware] part, which says how the electronics are calibrated")
        if count > CHANNELS:
            raise InputError(f"robot {robot.name}: {count} actuators; a board drives {CHANNELS}")
        pressure, tension = hardware.pressure, hardware.tension

        def each(value: float | tuple[float, ...], name: str) -> np.ndarray:
            if isinstance(value, tuple) and len(value) != count:
                raise InputError(f"robot {robot.name}: hardware.{name} has {len(value)} values; valid: one, or one for each of {count}")
            return Hardware.of_each(value, count)

        codes_per_V = DAC_CODES / each(pressure.dac_full_scale_V, "pressure.dac_full_scale_V")
        return Calibration(
            codes_per_V * each(pressure.V_per_MPa, "pressure.V_per_MPa") / 1e6,
            codes_per_V * each(pressure.zero_V, "pressure.zero_V"),
            COUNTS_PER_V * each(pressure.monitor_V_per_MPa, "pressure.monitor_V_per_MPa") / 1e6,
            COUNTS_PER_V * each(pressure.monitor_zero_V, "pressure.monitor_zero_V"),
            each(tension.counts_per_N, "tension.counts_per_N"),
            each(tension.zero_counts, "tension.zero_counts"),
            each(tension.steps_per_N, "tension.steps_per_N"),
            each(tension.steps_per_mm, "tension.steps_per_mm"),
        )

    def to_codes(self, pressures: np.ndarray, most: int) -> list[int]:
        """DAC codes of pressures in Pa, for all channels of a board whose largest code is `most`.

        Raises:
            InputError: the board's compiled limit is lower.
        """
        return self._round_to_board(self.codes_zero + self.codes * pressures, most, "pressure", pressures / 1e6, "MPa")

    def to_counts(self, tensions: np.ndarray, most: int) -> list[int]:
        """Counts of the dynamometers at tensions in N, for all channels of a board whose largest number of them is `most`.

        Raises:
            InputError: the board's compiled limit is lower.
        """
        return self._round_to_board(self.counts_zero + self.counts * tensions, most, "tension", tensions, "N")

    def to_steps(self, tensions: np.ndarray, most: int) -> list[int]:
        """Steps of the motors from where the tendons are slack, for all channels of a board whose largest number of them is `most`.

        Raises:
            InputError: the board's compiled limit is lower.
        """
        return self._round_to_board(self.steps * tensions, most, "tension", tensions, "N")

    def pressures(self, monitors: tuple[int, ...]) -> np.ndarray:
        """Pressures in Pa from the monitors' counts, (actuators of all modules,)."""
        return (np.array(monitors[: len(self.codes)]) - self.monitor_zero) / self.monitor

    def tensions(self, dynamometers: tuple[int, ...]) -> np.ndarray:
        """Tensions in N from the dynamometers' counts, (actuators of all modules,)."""
        return (np.array(dynamometers[: len(self.codes)]) - self.counts_zero) / self.counts

    def _round_to_board(self, values: np.ndarray, most: int, kind: str, wanted: np.ndarray, unit: str) -> list[int]:
        whole = np.round(values)
        if (whole > most + 1).any():  # the limit itself may be rounded down
            first = int(np.argmax(whole > most + 1))
            value = f"{kind} of the board's actuator {first + 1} = {wanted[first]:g} {unit}"
            raise InputError(f"command: {value} exceeds the limit that is compiled into the firmware, which is one for all actuators")
        return [*(int(value) for value in np.clip(whole, 0, most)), *[0] * (CHANNELS - len(values))]

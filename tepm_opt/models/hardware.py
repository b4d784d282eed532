"""Wiring and calibration of a robot's electronics: the `[hardware]` part of a robot file. Volts, counts and steps; no bytes."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from tepm_opt.data.documents import Number, Section, require_range

COUNTS_PER_V = 32768 / 5
"""Counts that a board sends for a volt: all analog inputs are given as if converted with 15 bits over 5 V."""
Point = Annotated[tuple[Number, Number, Number], Field(description="three numbers in m")]
Each = Number | tuple[Number, ...]
"""One number for all actuators, or a list with one for each."""


def _require_scalar(value: object) -> object:
    if not isinstance(value, bool | int | float | str):
        raise ValueError("not an option; valid: text, a number, true or false")
    return value


Option = Annotated[bool | int | float | str, BeforeValidator(_require_scalar)]
"""A value of `[hardware.tracker.options]`, whose kind of tracker says which there are."""


def each_between(low: float, high: float, unit: str) -> AfterValidator:
    """Range for every number of an `Each`."""

    def check(value: float | tuple[float, ...]) -> float | tuple[float, ...]:
        if not np.all((np.asarray(value) >= low) & (np.asarray(value) <= high)):
            raise ValueError(f"outside its range; valid: {low:g} … {high:g} {unit}, one number or one for each actuator")
        return value

    return AfterValidator(check)


class PressureLines(Section):
    """Maps from pressure to the regulator's command voltage and back from its monitor output. Both are straight lines.

    A voltage is zero_V + V_per_MPa · pressure; the DAC gives `dac_full_scale_V` at its largest code. `monitor_noise_Pa` is the noise of the
    monitor output (1 sigma); 0: unknown.
    """

    dac_full_scale_V: Annotated[Each, each_between(1, 24, "V")] = 5.0
    zero_V: Annotated[Each, each_between(-1, 5, "V")] = 0.0
    V_per_MPa: Annotated[Each, each_between(0.1, 100, "V/MPa")] = 5.0 / 0.9
    monitor_zero_V: Annotated[Each, each_between(-1, 5, "V")] = 1.0
    monitor_V_per_MPa: Annotated[Each, each_between(0.1, 100, "V/MPa")] = 4.0 / 0.9
    monitor_noise_Pa: Annotated[Each, each_between(0, 1e5, "Pa")] = 0.0


class TensionLines(Section):
    """Maps from tension to counts of the dynamometer's converter (zero_counts + counts_per_N · tension) and to steps of the motor.

    `noise_N` is the noise of the dynamometers (1 sigma); 0: unknown.
    """

    zero_counts: Annotated[Each, each_between(0, 32767, "counts")] = 3277.0
    counts_per_N: Annotated[Each, each_between(1, 32767, "counts/N")] = 3276.8
    noise_N: Annotated[Each, each_between(0, 10, "N")] = 0.0
    steps_per_N: Annotated[Each, each_between(1, 1e5, "steps/N")] = 1 / 1.05e-3
    steps_per_mm: Annotated[Each, each_between(0.1, 1e5, "steps/mm")] = 290e-3 / 1.05e-3


class TrackerLink(Section):
    """Source of the tracker's poses, and how the sensors sit on the robot.

    A reference point is R h + t of its sensor's pose (R, t) in G: `holders_m` has an h for each point, from the base to the tip.
    `holders_m` absent: the sensors sit on the reference points.
    """

    kind: Annotated[str, Field(min_length=1)] = "openigtlink"
    options: Annotated[dict[str, Option], Field(default_factory=dict)]
    """Options of this kind of tracker."""
    host: Annotated[str, Field(min_length=1)] = "127.0.0.1"
    port: Annotated[int, Field(strict=True, ge=1, le=65535, description="1 … 65535")] = 18944
    devices: Annotated[tuple[str, ...], Field(description="names of the transforms, from the base to the tip")]
    holders_m: tuple[Point, ...] | None = None
    units_per_m: Annotated[float, require_range(1e-3, 1e6, "(1000: poses are in mm)")] = 1000.0
    latency_s: Annotated[float, require_range(0, 1, "s")] = 0.0
    """Age of a pose when it gets its time stamp."""
    rate_hz: Annotated[float, require_range(1, 1000, "Hz a sensor")] = 100.0
    largest_step_m: Annotated[float, require_range(1e-4, 1, "m")] = 0.05
    """Further than this in one frame is a jump, not a motion."""

    @model_validator(mode="after")
    def _a_holder_for_each(self) -> TrackerLink:
        if self.holders_m is not None and len(self.holders_m) != len(self.devices):
            raise ValueError(f"holders_m has {len(self.holders_m)} entries for {len(self.devices)} devices; one for each")
        if len(set(self.devices)) != len(self.devices):
            raise ValueError(f"devices: {', '.join(self.devices)}; each sensor has a name of its own")
        return self


class Hardware(Section):
    """Data of the board, the regulators, the motors and the tracker that the host needs."""

    pressure: PressureLines = PressureLines()
    tension: TensionLines = TensionLines()
    tracker: TrackerLink | None = None

    @staticmethod
    def of_each(value: float | tuple[float, ...], count: int) -> np.ndarray:
        """A calibration constant for each of `count` actuators, (count,)."""
        return np.broadcast_to(np.asarray(value, dtype=float), (count,)).copy()

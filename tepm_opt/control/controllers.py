"""Controllers that follow a reference, whichever they are: the predictive one and the paper's two modes."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from tepm_opt.control.length_control import LengthController, LengthSettings, LengthTarget, TendonUse
from tepm_opt.control.lengths import LengthEstimator
from tepm_opt.control.mpc import Mpc, MpcSettings
from tepm_opt.control.reference import Reference
from tepm_opt.errors import unknown_name
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.models.compile import CompiledModel

CONTROLLERS = ("mpc", "mode1", "mode2")


class Controller(Protocol):
    """What follows a reference, sample by sample."""

    reference: Reference

    def start(self) -> Command:
        """Where the robot shall rest before the first sample."""
        ...

    def command(self, sample: Sample) -> Command:
        """Set points for a sample."""
        ...


class LengthFollower:
    """The paper's length PID (IV.A) along a reference: set points are the reference's lengths, feed-forward its axial forces.

    Lengths are those of the nominal equilibrium that fits the tracked points best, as everywhere.

    Args:
        model: the nominal one, compiled.
        reference: what to follow.
        use: mode 1 or 2.
        settings: gains; the same as for Figs. 6 and 12.
    """

    def __init__(self, model: CompiledModel, reference: Reference, use: TendonUse, settings: LengthSettings | None = None) -> None:
        self.reference = reference
        self._controller = LengthController(model.robot, use, settings or LengthSettings())
        self._estimator = LengthEstimator(model)
        self._limits = model.robot.input_max[: model.layout.inputs // 2]
        self._area = model.values["A"]
        self._zero: float | None = None

    def start(self) -> Command:
        """The pressures that make the reference's first forces, motors off."""
        pressure = np.clip(self.reference.forces[0] / self._area, 0.0, self._limits)
        return Command(pressure, np.zeros(len(pressure)), np.zeros(len(pressure), dtype=bool))

    def command(self, sample: Sample) -> Command:
        """Set points for a sample."""
        self._zero = sample.time if self._zero is None else self._zero
        row = int(self.reference.at(round((sample.time - self._zero) / self.reference.period)))
        lengths = self._estimator.update(sample.points)
        return self._controller.command(sample.time, lengths, LengthTarget(self.reference.lengths[row], self.reference.forces[row]))


def controller_named(name: str, model: CompiledModel, reference: Reference, settings: MpcSettings | None = None) -> Controller:
    """The controller of a name, one of `CONTROLLERS`, on a reference.

    Raises:
        InputError: no such controller.
    """
    if name not in CONTROLLERS:
        raise unknown_name("controller", name, CONTROLLERS)
    if name == "mpc":
        return Mpc(model, reference, settings or MpcSettings())
    return LengthFollower(model, reference, TendonUse(int(name[-1])))

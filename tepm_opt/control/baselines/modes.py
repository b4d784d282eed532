"""The paper's modes 1 and 2 (IV.A) along a reference: a PID on the length of every muscle."""

from __future__ import annotations

from functools import partial

import numpy as np

from tepm_opt.control.baselines.length_control import LengthController, LengthSettings, LengthTarget, TendonUse
from tepm_opt.control.controller import ControllerKind, ControllerSettings, Telemetry
from tepm_opt.control.estimation.lengths import LengthEstimator
from tepm_opt.control.references.reference import Reference
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.models.compile import CompiledModel


class LengthFollower:
    """Length PID along a reference: set points are the reference's lengths, feed-forward its axial forces.

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
        row = int(self.reference.rows_at(round((sample.time - self._zero) / self.reference.period)))
        lengths = self._estimator.update(sample.points)
        return self._controller.command(sample.time, lengths, LengthTarget(self.reference.lengths[row], self.reference.forces[row]))

    def telemetry(self) -> Telemetry:
        """Nothing beside what every log has."""
        return Telemetry()

    def __repr__(self) -> str:
        return f"LengthFollower(mode {self._controller.use.value}, {self.reference!r})"


def _follower(use: TendonUse, model: CompiledModel, reference: Reference, settings: ControllerSettings) -> LengthFollower:
    """Length control with the gains of Figs. 6 and 12; there are no other settings."""
    return LengthFollower(model, reference, use)


MODE1 = ControllerKind("mode1", "mode 1", "paper's mode 1 (pressure)", partial(_follower, TendonUse.FOLLOWS), jumps=True)
MODE2 = ControllerKind("mode2", "mode 2", "paper's mode 2 (with tension)", partial(_follower, TendonUse.ADJUSTS), jumps=True)

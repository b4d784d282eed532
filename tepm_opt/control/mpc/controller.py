"""Predictive control of the tip: pressures coarsely, tensions finely, in one control step (see `python_step` for the method)."""

from __future__ import annotations

from dataclasses import replace

from tepm_opt.control.controller import ControllerKind, ControllerSettings, Telemetry, own_settings
from tepm_opt.control.diagnostics.marker_slip import Markers
from tepm_opt.control.diagnostics.monitor_delay import MonitorDelay
from tepm_opt.control.diagnostics.sensors import SensorDiagnostics
from tepm_opt.control.mpc.compiled.setup import StepSetup
from tepm_opt.control.mpc.compiled.step import CompiledStep
from tepm_opt.control.mpc.python_step import PythonStep
from tepm_opt.control.mpc.record import ControlStep, Step
from tepm_opt.control.mpc.settings import MpcSettings, Use
from tepm_opt.control.mpc.timing import computing_time
from tepm_opt.control.references.reference import Reference
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.models.compile import CompiledModel

__all__ = ["MPC", "Mpc", "MpcSettings", "Use", "make_mpc"]
DEFAULT = MpcSettings()


def make_step(setup: StepSetup) -> ControlStep:
    """The step of a setup: in C where its backend allows it, else in Python.

    Raises:
        InputError: backend "c" where the step cannot be in C.
    """
    half = len(setup.tension_max)
    doubts = SensorDiagnostics(setup.model.layout.actuator_names, (setup.model.robot.input_max[:half], setup.tension_max))
    return CompiledStep.from_setup(setup, doubts) or PythonStep(setup, doubts)


class Mpc:
    """The controller on one reference.

    Args:
        model: compiled; its effects are compensated.
        reference: targets of the tip.
        settings: of the controller.
        computing: time in s from a sample to its command, where the settings leave it to be measured (see `make_mpc`).

    Attributes:
        setup: what its step is made of.
        settings: of the controller.
        reference: as begun by this controller.

    Raises:
        InputError: `backend="c"` where the step cannot be in C; no computing time.
    """

    def __init__(self, model: CompiledModel, reference: Reference, settings: MpcSettings = DEFAULT, computing: float | None = None) -> None:
        took = settings.computing if computing is None else computing
        if took is None:
            raise InputError("computing: None; valid: a time in s, or make_mpc(…), which measures it")
        self.settings, self.setup = settings, StepSetup.from_model(model, reference, settings, took)
        self.reference = self.setup.reference
        self._step = make_step(self.setup)
        self._markers = Markers(model.layout.point_names, reference.period)
        self._delay = MonitorDelay(reference.period)
        self._fresh: tuple[Sample, Command] | None = None  # of which nobody has looked what is wrong with it

    def __repr__(self) -> str:
        steps = "C" if self.is_c else "Python"
        return f"Mpc({self.setup.model.robot.name} in {steps}, {self.reference!r}, fallbacks={self.fallbacks})"

    @property
    def is_c(self) -> bool:
        """Whether it steps in compiled C."""
        return isinstance(self._step, CompiledStep)

    @property
    def ahead(self) -> int:
        """Periods from a sample to when a new command acts, as far as is known."""
        return self._step.ahead

    @property
    def last(self) -> Step | None:
        """Record of the last step; None before the first one."""
        return self._step.last

    @property
    def fallbacks(self) -> dict[str, int]:
        """Number of steps that went on with an older plan, by the reason."""
        return self._step.fallbacks

    def start(self) -> Command:
        """Set points under which the robot shall rest before the first sample."""
        return self.setup.first

    def command(self, sample: Sample) -> Command:
        """Set points for a sample; never NaN, always within the limits. What `prepare` has not prepared is prepared first."""
        self._look()
        taken = self._markers.undo_slips(sample)
        command = self._step.feedback(replace(taken, pressures=None) if self._delay.late else taken, self.settings.deadline)
        self._fresh = taken, command
        return command

    def prepare(self) -> None:
        """Do what the next sample is not needed for, should it come a period after the last one; best as soon as a command is sent."""
        self._look()
        self._step.prepare()

    def telemetry(self) -> Telemetry:
        """Estimate, quadratic program and moves of the last step, and doubts as of the last preparation."""
        told, more = self._step.telemetry(), {**self._markers.describe_slips(), **self._delay.describe()}
        return replace(told, doubts={**told.doubts, **more}) if more else told

    def _look(self) -> None:
        """Look once whether a tracked point of the last sample has slipped, or the pressure monitors are late."""
        if self._fresh is not None:
            (sample, command), self._fresh = self._fresh, None
            self._markers.look(sample, self._step.noise)
            if self._delay.look(sample.time, sample.pressures, command.pressures):
                self._step.distrust_monitors()


def make_mpc(model: CompiledModel, reference: Reference, settings: ControllerSettings = DEFAULT) -> Mpc:
    """A controller whose computing time is measured first, on a step of its own, where its settings say so.

    Args:
        model: compiled.
        reference: targets of the tip.
        settings: of the predictive controller.

    Raises:
        InputError: settings of another controller; `backend="c"` where the step cannot be in C.
    """
    own = own_settings(settings, MpcSettings)
    if own.computing is not None:
        return Mpc(model, reference, own)
    trial = StepSetup.from_model(model, reference, own, 0.0)
    return Mpc(model, reference, own, computing_time(make_step(trial), trial.reference))


MPC = ControllerKind("mpc", "MPC", "predictive controller", make_mpc, ("use",), MpcSettings.from_options)

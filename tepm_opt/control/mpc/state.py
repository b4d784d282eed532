"""State that the predictive controller's step in Python carries from sample to sample, and what it prepares between them."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from tepm_opt.control.actuation.actuators import Actuators, InputEffects
from tepm_opt.control.actuation.delay_line import CommandDelayLine
from tepm_opt.control.actuation.regulator_lags import RegulatorFindings, RegulatorLags
from tepm_opt.control.diagnostics.sensors import TrackerNoise
from tepm_opt.control.estimation.kalman_filter import DiscreteModalModel, Estimator
from tepm_opt.control.mpc.compiled.layout import count_kept_points
from tepm_opt.control.mpc.compiled.setup import StepSetup
from tepm_opt.control.mpc.lag_factor import LagFactor
from tepm_opt.hw.rig import Sample
from tepm_opt.solvers.linear.modal_model import ModalModel, modal_model


class OperatingPoints:
    """Local models of the network about the reference, of which the newest are kept.

    Args:
        setup: with reference and damping.
    """

    def __init__(self, setup: StepSetup) -> None:
        self._setup, self._kept = setup, count_kept_points(setup.ahead)
        self._found: dict[int, tuple[int, DiscreteModalModel]] = {}
        self._newest: ModalModel | None = None

    def find(self, period: int) -> DiscreteModalModel:
        """The model about the reference at a period, linearised where it is not kept."""
        reference = self._setup.reference
        row = int(reference.rows_at(period))
        at, found = self._found.get(row % self._kept, (-1, None))
        if found is None or at != row:
            self._newest = modal_model(reference.equilibria[row], self._newest)
            found = DiscreteModalModel.from_modal_model(
                self._newest.scale_damping(self._setup.controller.damping), reference.forces[row], reference.period
            )
            self._found[row % self._kept] = row, found
        return found


@dataclass(eq=False)
class MpcState:
    """State of one controller from sample to sample.

    Attributes:
        estimator, actuators: at the last sample.
        lag_factor: of regulators without monitors, likewise.
        effects: of the model on its inputs, likewise.
        sent: commands on their way.
        noise: of the tracker.
        slow: disturbance forces as far as the pressures have taken them over, (actuators,) in N.
        extra: planned feedback as far as the pressures take part in it, (stages, actuators) in N.
        row: of the reference, at the last sample.
        plan: tensions of the coming stages, (stages, actuators) in N; None before the first plan.
        planned: deviations of the forces that it leads to, likewise; None while an older plan goes on.
        pressed: whether the arm presses into a margin, so that pressures help at once.
        regulators: their differences from the robot file, as of the last preparation.
        late: time in s by which commands act later than declared, likewise.
        taken: sample that noise and doubts have not been updated by.
    """

    estimator: Estimator
    actuators: Actuators
    lag_factor: LagFactor
    effects: InputEffects
    sent: CommandDelayLine
    noise: TrackerNoise
    slow: np.ndarray
    extra: np.ndarray
    regulators: RegulatorFindings
    late: float = 0.0
    row: int = 0
    plan: np.ndarray | None = None
    planned: np.ndarray | None = None
    pressed: bool = False
    taken: Sample | None = None

    @staticmethod
    def at_rest(setup: StepSetup, operating: DiscreteModalModel) -> MpcState:
        """The state before the first sample, at an operating point."""
        first, period, settings = setup.first, setup.reference.period, setup.controller
        lags = RegulatorLags(setup.devices, period, setup.planner.limits, first.pressures)
        count = len(setup.tension_max)
        estimator = Estimator(operating, setup.noise, settings.mid_range * float(setup.tension_max[0]), setup.filter)
        factor = LagFactor(count, len(estimator.mean))
        factor.tell(lags)
        return MpcState(
            estimator, Actuators(setup.devices, setup.area, first, lags), factor, copy.copy(setup.effects),
            CommandDelayLine(first, period, setup.ahead), TrackerNoise(setup.noise), np.zeros(count), np.zeros((settings.stages, count)),
            lags.findings,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Prepared:
    """Results that are ready before a sample comes.

    Attributes:
        row: of the reference, at which the sample is expected; `ahead` periods later a new command can act.
        ahead: as of then.
        rows: of the reference at stages −1, 0, 1, …, (preview + 3,).
        estimator, actuators, lag_factor: brought up to the sample's time.
        then: operating point when a new command can act.
        directions: which way friction pulls after each period until then, (ahead, actuators).
        courses: and over the coming stages, (preview, actuators).
        foreseen: friction there as far as known before the sample, (preview, actuators) in N.
        factor: of the tensions by it, (preview, actuators).
    """

    row: int
    ahead: int
    rows: np.ndarray
    estimator: Estimator
    actuators: Actuators
    lag_factor: LagFactor
    then: DiscreteModalModel
    directions: np.ndarray
    courses: np.ndarray
    foreseen: np.ndarray
    factor: np.ndarray


@dataclass(frozen=True, eq=False)
class Ahead:
    """State at the time when a new command can act: [q, q'] about the operating point, the actuators, which way hysteresis pulls."""

    motion: np.ndarray
    actuators: Actuators
    turning: np.ndarray

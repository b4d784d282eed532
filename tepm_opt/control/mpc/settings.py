"""Options and settings of the predictive controller."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Literal

from tepm_opt.control.actuation.pressure_planner import PressurePlannerSettings
from tepm_opt.control.controller import Option
from tepm_opt.control.estimation.kalman_filter import FilterSettings
from tepm_opt.control.mpc.prediction import Weights
from tepm_opt.errors import InputError, unknown_name

DAMPING = 2.0  # times the model's: dry friction of body and tendons takes from sway what a linear model does not have


class Use(Enum):
    """Actuators that a controller uses."""

    BOTH = "both"
    TENSION = "tension"
    PRESSURE = "pressure"


@dataclass(frozen=True)
class MpcSettings:
    """Settings of the predictive controller; weights and planner tuned on the virtual prototype with its nominal model.

    Attributes:
        stages: length of the prediction horizon in stages of two control periods.
        weights: cost of errors and efforts.
        mid_range: tension to which mid-ranging lets the motors return, as part of their range.
        mid_ranging: whether the pressures take over what the tensions do for longer; else they only follow the reference.
        use: which actuators move; those left out keep still.
        damping: times the model's damping that filter and program reckon with; with 1.5 the circle on twenty random machines is 3 % worse,
            with 2.5 machines without friction are a tenth further off than with 2.
        pressure_planner: settings of the pressures.
        filter: settings of the state estimator; None for the defaults with the noise levels of the model file (`tepm tune`).
        deadline: duration of a step in s after which its program is not used and the last plan goes on.
        computing: time in s from a sample to its command, which counts as delay; None for what `make_mpc` measures.
        backend: "auto" steps in C where model, settings and compiler allow it; "c" insists on it; "python" never does: the same commands.
    """

    stages: int = 15
    weights: Weights = field(default_factory=Weights)
    mid_range: float = 0.5
    mid_ranging: bool = True
    use: Use = Use.BOTH
    damping: float = DAMPING
    pressure_planner: PressurePlannerSettings = field(default_factory=PressurePlannerSettings)
    filter: FilterSettings | None = None
    deadline: float = math.inf
    computing: float | None = 0.0
    backend: Literal["auto", "c", "python"] = "auto"

    def __post_init__(self) -> None:
        """Check that pressures are planned over the whole horizon.

        Raises:
            InputError: they are not.
        """
        if self.pressure_planner.preview < self.stages:
            told = f"pressure_planner.preview: {self.pressure_planner.preview}"
            raise InputError(f"{told} stages; valid: at least the {self.stages} of the horizon")

    @property
    def asked(self) -> dict[str, Option]:
        """Options of the command line that give these settings."""
        return {"use": self.use.value}

    def in_real_time(self, period: float) -> MpcSettings:
        """Settings with which a step that takes longer than a control period in s is late, and with which what it takes is a delay."""
        return replace(self, deadline=min(self.deadline, period), computing=None)

    @staticmethod
    def from_options(options: Mapping[str, Option]) -> MpcSettings:
        """Settings for options of the command line: "use", where it was given.

        Raises:
            InputError: no such use.
        """
        use, known = str(options.get("use", Use.BOTH.value)), [kind.value for kind in Use]
        if use not in known:
            raise unknown_name("use", use, known)
        return MpcSettings(use=Use(use))

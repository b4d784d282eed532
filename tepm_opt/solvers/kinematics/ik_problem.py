"""Equations of the inverse kinematics: tip error and length differences as functions of the axial forces."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from tepm_opt.models.backends.interface import LIMIT_SLACK, InverseProblem, Status
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.layout import Layout
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.kinematics.allocation import allotment, force_range
from tepm_opt.solvers.kinematics.constant_curvature import lengths_from_tip
from tepm_opt.solvers.mechanics.statics import DEFAULT as STATICS
from tepm_opt.solvers.mechanics.statics import Equilibrium, solve_actuated_statics


@dataclass(frozen=True)
class IkSettings:
    """Settings of the inverse kinematics.

    Attributes:
        tolerance: largest error of tip and length differences, m.
        max_iterations: most Gauss-Newton steps from one start.
        max_step: largest change of an axial force in one step, N.
    """

    tolerance: float = 1e-9
    max_iterations: int = 30
    max_step: float = 8.0


@dataclass(frozen=True)
class Balance:
    """Axial forces (actuators,) in N, their equilibrium, and the steps a search took to them."""

    forces: np.ndarray
    equilibrium: Equilibrium
    steps: int = 0


@lru_cache(maxsize=16)
def _weights(layout: Layout) -> np.ndarray:
    """Rows that make tip and length differences of the observations (points in G, then lengths)."""
    half = layout.inputs // 2
    tip = np.zeros((3, 3 * layout.points + half))
    tip[:, 3 * layout.points - 3 : 3 * layout.points] = np.eye(3)
    differences = np.zeros(((layout.modules - 1) * layout.actuators, tip.shape[1]))
    lengths = differences[:, 3 * layout.points :]
    for row in range(len(lengths)):
        lengths[row, row + layout.actuators], lengths[row, row % layout.actuators] = 1.0, -1.0
    return np.concatenate([tip, differences])


class IkProblem:
    """Tip error and length differences as functions of the axial forces, with derivatives, and what all targets share."""

    def __init__(
        self, model: CompiledModel, loads: np.ndarray, mode: ActuationMode, mid_tension: float | None, settings: IkSettings
    ) -> None:
        """Prepare the problem of a model.

        Args:
            model: compiled model.
            loads: known forces on the reference points in G, (points, 3) in N.
            mode: how forces are made.
            mid_tension: see `allocate`.
            settings: tolerances.
        """
        self.model, self.loads, self.mode, self.settings, self.mid_tension = model, loads, mode, settings, mid_tension
        self.low, self.high = force_range(model, mode)
        self.area, self.half = model.values["A"], model.layout.inputs // 2
        self.allotment = allotment(model, mode, mid_tension)
        self.weights = _weights(model.layout)
        self.redundant = len(self.weights) < self.half
        mount = model.robot.mount
        self._to_base, self._base = mount.rotation.T, np.array(mount.base_position_m)

    @cached_property
    def shared(self) -> InverseProblem:
        """The same for the backend."""
        settings, shortest = self.settings, STATICS.min_length_ratio * self.model.values["L_0"]
        return InverseProblem(
            self.loads.ravel(), self.model.theta, self.weights, self.low, self.high, shortest, self.allotment,
            settings.max_step, settings.tolerance / 2, STATICS.tolerance, settings.max_iterations,
        )  # fmt: skip

    def local(self, target: np.ndarray) -> np.ndarray:
        """A point of G in the base frame, (3,) in m."""
        return self._to_base @ (target - self._base)

    def actuation(self, forces: np.ndarray) -> np.ndarray:
        """Effective actuation (inputs,) of axial forces."""
        effective = np.zeros(2 * self.half)
        effective[: self.half] = forces / self.area
        return effective

    def seed(self, target: np.ndarray) -> np.ndarray:
        """Axial forces by the constant-curvature lengths and the actuators' stiffness, within the limits; 0 where no arc leads there."""
        robot, value = self.model.robot, self.model.values
        try:
            lengths = lengths_from_tip(self.local(target), robot.modules, value["r"], self.model.layout.angles)
        except ValueError:
            return np.zeros(self.half)
        return np.minimum(np.maximum((lengths.ravel() - value["L_0"]) * value["K_a"], self.low), self.high)

    def solve_equilibrium(self, forces: np.ndarray, start: Equilibrium | None) -> Equilibrium:
        """Solve for the equilibrium of axial forces."""
        return solve_actuated_statics(self.model, self.actuation(forces), self.loads, start)

    @property
    def middle(self) -> np.ndarray:
        """Axial forces in the middle of their ranges, (actuators,) in N."""
        return (self.low + self.high) / 2

    @cached_property
    def balanced(self) -> Equilibrium:
        """Equilibrium under them."""
        return self.solve_equilibrium(self.middle, None)

    @cached_property
    def idle(self) -> Equilibrium:
        """Equilibrium without inputs."""
        return self.solve_equilibrium(np.zeros(self.half), None)

    def errors(self, at: Equilibrium, target: np.ndarray) -> np.ndarray:
        """Tip error, then length differences to the first module, in m."""
        return np.concatenate([at.tip - target, (at.lengths[1:] - at.lengths[:1]).ravel()])

    def jacobian(self, at: Equilibrium) -> np.ndarray:
        """Derivatives of `errors` by the axial forces in m/N.

        Raises:
            LinAlgError: the equilibrium is not stable.
        """
        status, by_u, _, _ = self.model.statics.sensitivity(at.x, at.load_case, self.weights, False)
        if status != Status.SOLVED:
            raise np.linalg.LinAlgError("stiffness not positive definite")
        return by_u[:, : self.half] / self.area

    def is_within_limits(self, forces: np.ndarray) -> bool:
        """Whether axial forces are within their limits."""
        slack = LIMIT_SLACK * (self.high - self.low)
        return bool(((forces >= self.low - slack) & (forces <= self.high + slack)).all())

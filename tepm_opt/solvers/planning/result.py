"""Result of planning: the motion, its set points, its numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.models.compile import CompiledModel
from tepm_opt.outcome import Outcome
from tepm_opt.solvers.planning.objective import Objective


@dataclass(frozen=True, eq=False)
class MotionPlan:
    """A motion from rest to rest, at the rows of its set points; without rows where there is none.

    Attributes:
        model: of which.
        objective: what was made small.
        outcome: SOLVED, OUT_OF_REACH, BLOCKED or NO_PLAN; its message explains all but SOLVED.
        time: (n,) in s.
        tips: (n, 3) in m in G.
        points: reference points by exact equilibria, (n, points, 3) in m in G.
        forces: axial forces F, inertia and damping included, (n, modules · 3) in N.
        setpoints: what the rig plays.
        margin: smallest stiffness eigenvalue on the way, N/m.
        effort: see `Objective`, N²/s.
        sway_frequencies: of the arm at both ends and on the way, lowest and highest, Hz.
        residual_sway: largest distance of the tip from rest in the 5 s after the end, in a simulation of the full network, m.
        doubted_sway: the same, the most of it where the sway's frequencies are off by their doubt either way, m.
        friction_offset: how far friction of the tendons, the model's and its doubt, may hold the tip from its rest on a rig, m. Set points
            alone do not take it away, a controller does.
        surrogate_error: of the reference points and forces of the polynomials against the exact ones along the way, m and N.
        iterations, seconds: quadratic programs, and what they took, all attempts together.
    """

    model: CompiledModel
    objective: Objective
    outcome: Outcome
    time: np.ndarray
    tips: np.ndarray
    points: np.ndarray
    forces: np.ndarray
    setpoints: SetPoints
    margin: float = 0.0
    effort: float = 0.0
    sway_frequencies: tuple[float, float] = (0.0, 0.0)
    residual_sway: float = 0.0
    doubted_sway: float = 0.0
    friction_offset: float = 0.0
    surrogate_error: tuple[float, float] = (0.0, 0.0)
    iterations: int = 0
    seconds: float = 0.0

    def __repr__(self) -> str:
        """The outcome and the main numbers, in a line."""
        way = f"{self.duration:.4g} s, {len(self.time)} rows, tip within {1e3 * self.residual_sway:.2g} mm of rest at the end"
        return f"MotionPlan({self.outcome.ending}, {self.objective}{', ' + way if len(self.time) else ''})"

    @property
    def solved(self) -> bool:
        """Whether there is a plan."""
        return self.outcome.solved

    @property
    def duration(self) -> float:
        """Seconds it takes; 0 without a plan."""
        return float(self.time[-1]) if len(self.time) else 0.0

    def summary(self) -> dict[str, Any]:
        """Numbers of the plan."""
        found: dict[str, Any] = {"robot": self.model.robot.name, "objective": self.objective.value, "outcome": self.outcome.ending.value}
        found |= {
            "message": self.outcome.message or None,
            "rows": len(self.time),
            "iterations": self.iterations,
            "seconds": round(self.seconds, 3),
        }
        if not len(self.time):
            return found
        half, inputs = self.model.layout.inputs // 2, self.setpoints.inputs
        speeds = np.linalg.norm(np.gradient(self.tips, self.time, axis=0), axis=1)
        return found | {
            "duration_s": self.duration,
            "path_length_m": float(np.linalg.norm(np.diff(self.tips, axis=0), axis=1).sum()),
            "largest_speed_m_per_s": float(speeds.max()),
            "largest_pressure_Pa": float(inputs[:, :half].max()),
            "tensions_N": [float(inputs[:, half:].min()), float(inputs[:, half:].max())],
            "largest_tension_rate_N_per_s": float((np.abs(np.diff(inputs[:, half:], axis=0)).max(axis=1) / np.diff(self.time)).max()),
            "smallest_stiffness_eigenvalue_N_per_m": self.margin,
            "effort_N2_per_s": self.effort,
            "sway_frequencies_Hz": list(self.sway_frequencies),
            "left_over_m": self.residual_sway,
            "left_on_rig_m": {"sway": self.doubted_sway, "friction": self.friction_offset},
            "surrogate_error_m": self.surrogate_error[0],
            "surrogate_error_N": self.surrogate_error[1],
        }

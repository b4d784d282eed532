"""Reach of the tip: the outer boundary of the equal-curvature workspace."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tepm_opt.models.compile import CompiledModel
from tepm_opt.outcome import Ending
from tepm_opt.progress import Progress, silent, track
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.kinematics.ik import solve_ik

FAR = 1.5  # of the arm's length: where points are sought from
AROUND, POLAR = 18, 8
WIDEST = 110.0  # degrees from the base axis


@dataclass(frozen=True, eq=False)
class Boundary:
    """Points of the boundary, one for each direction from which it is sought.

    Attributes:
        points: in G, (polar angles, directions about the axis, 3) in m; NaN where none was found. The first polar angle is 0.
    """

    points: np.ndarray

    def __repr__(self) -> str:
        found = np.isfinite(self.points).all(axis=-1)
        return f"Boundary({int(found.sum())} of {found.size} directions)"

    @property
    def pieces(self) -> np.ndarray:
        """Meridians and parallels as pieces of lines, (pieces, 2, 3) in m."""
        along = np.stack([self.points[:-1], self.points[1:]], axis=2).reshape(-1, 2, 3)
        around = np.stack([self.points, np.roll(self.points, -1, axis=1)], axis=2)[1:].reshape(-1, 2, 3)
        every = np.concatenate([along, around])
        return every[np.isfinite(every).all(axis=(1, 2))]


def boundary(
    model: CompiledModel, mode: ActuationMode = ActuationMode.HYBRID, around: int = AROUND, polar: int = POLAR, progress: Progress = silent
) -> Boundary:
    """The outer boundary: the nearest point within the limits to targets far outside, on a sphere about the first module's end.

    Args:
        model: compiled model.
        mode: how axial forces are made.
        around: number of directions about the base axis.
        polar: number of angles from the base axis.
        progress: told of every direction.
    """
    mount, length = model.robot.mount, model.robot.modules * model.values["L_0"]
    angles, azimuths = np.radians(np.linspace(0, WIDEST, polar)), np.linspace(0, 2 * np.pi, around, endpoint=False)
    theta, phi = np.meshgrid(angles, azimuths, indexing="ij")
    outward = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    targets = np.array([0.0, 0.0, model.values["L_0"]]) + FAR * length * outward
    points = np.full(targets.shape, np.nan)
    wanted = [(row, column) for row in range(polar) for column in range(around if row else 1)]
    for place in track(iter(wanted), progress, "workspace", len(wanted)):
        found = solve_ik(model, mount.rotation @ targets[place] + mount.base_position_m, mode)
        if found.outcome.ending is not Ending.FAILED and found.equilibrium.solved:
            points[place] = found.equilibrium.tip
    points[0] = points[0, 0]
    return Boundary(points)

"""The arm as a chain of rods from the base through the reference points; each turns about x and y and slides."""

from __future__ import annotations

import numpy as np

from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot

AXES = ("x", "y", "z")
"""Joints of a rod, in their order: it turns about x, then about y, and slides along z, all of them its parent's axes."""


class RodChain:
    """Joints of the chain of a robot.

    Attributes:
        points: names of the reference points, from the base to the tip; each ends a rod.
        joints: names of the joints, three a rod: "s1_x", "s1_y", "s1_z".
        lengths: of the rods at rest, (points,) in m.
    """

    def __init__(self, robot: Robot) -> None:
        layout, mount = Layout.from_robot(robot), robot.mount
        centres = layout.rest_positions(robot.parameters.r, robot.parameters.L_0).mean(axis=1)
        self.points = layout.point_names
        self.joints = tuple(f"{point}_{axis}" for point in self.points for axis in AXES)
        self.lengths = np.diff(layout.point_weights @ centres[:, 2], prepend=0.0)
        self._base, self._axes = np.asarray(mount.base_position_m), mount.rotation

    def positions(self, points: np.ndarray) -> np.ndarray:
        """Positions of the joints, (3 · points,) in rad and m, at which the rods end at `points` (points, 3) in G in m; NaN from the first
        point on that is lost."""
        found, axes, start = np.empty((len(self.lengths), 3)), self._axes, self._base
        for row, (end, rest) in enumerate(zip(points, self.lengths, strict=True)):
            x, y, z = axes.T @ (end - start)
            a, b = np.arctan2(-y, z), np.arctan2(x, np.hypot(y, z))
            found[row], start = (a, b, np.sqrt(x * x + y * y + z * z) - rest), end
            ca, sa, cb, sb = np.cos(a), np.sin(a), np.cos(b), np.sin(b)
            axes = axes @ np.array([[cb, 0, sb], [sa * sb, ca, -sa * cb], [-ca * sb, sa, ca * cb]])
        return found.ravel()

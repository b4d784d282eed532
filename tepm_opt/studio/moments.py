"""A rig as it moves: how a moment of it is drawn and told."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot
from tepm_opt.solvers.kinematics.backbone import backbone
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.studio.loop import Moment
from tepm_opt.studio.scene import ArmNode, line_node, set_lines
from tepm_opt.studio.shapes import BOUND, MEASURED, TARGET, nodes_in_g, polyline

if TYPE_CHECKING:
    import viser

PIECES = 200  # of the way drawn
LAST = 10.0  # s that the trace and the errors told go back
METRES_PER_NEWTON = 0.05


@dataclass(frozen=True, eq=False)
class Path:
    """Path of a tip: times in s (moments,), places (moments, 3) in m, distances from its targets (moments,) in m; NaN where lost."""

    time: np.ndarray
    tips: np.ndarray
    errors: np.ndarray

    def __repr__(self) -> str:
        return f"Path({len(self.time)} moments, {1e3 * self.rms:.3g} mm rms off its target)"

    @property
    def rms(self) -> float:
        """Root mean square of the errors that are known, in m; NaN where none is."""
        known = self.errors[np.isfinite(self.errors)]
        return float(np.sqrt((known**2).mean())) if len(known) else float("nan")


class Trace:
    """The last seconds of a rig; one thread may add while another looks."""

    def __init__(self) -> None:
        self._rows: deque[tuple[float, np.ndarray, float]] = deque()
        self._lock = threading.Lock()

    def add(self, moment: Moment) -> None:
        """Take a moment; what is older than the last seconds goes."""
        with self._lock:
            if self._rows and moment.time < self._rows[-1][0]:  # another loop
                self._rows.clear()
            self._rows.append((moment.time, moment.tip, moment.error))
            while self._rows[0][0] < moment.time - LAST:
                self._rows.popleft()

    @property
    def path(self) -> Path:
        """Path of the tip over the last seconds."""
        with self._lock:
            rows = list(self._rows)
        time, tips, errors = ([row[k] for row in rows] for k in range(3))
        return Path(np.array(time), np.array(tips).reshape(-1, 3), np.array(errors))


class MomentNode:
    """A rig in the scene: the true arm where it is known, else the tracked backbone; the tip's way, its target, what pushes it.

    Args:
        scene: viser's.
        robot: of the rig.
        limits: of its inputs, (2 · modules · actuators,) in Pa and N.
    """

    def __init__(self, scene: viser.SceneApi, robot: Robot, limits: np.ndarray) -> None:
        self._layout, self._limits, self._base = Layout.from_robot(robot), limits, np.array(robot.mount.base_position_m)
        radius = robot.parameters.r
        self._arm = ArmNode(scene, "rig", self._layout, radius)
        size = radius / 0.04
        self._backbone = line_node(scene, "/rig/backbone", 0.006 * size, MEASURED)
        self._trace = line_node(scene, "/rig/trace", 0.0025 * size, MEASURED)
        self._target = scene.add_icosphere("/rig/target", 0.009 * size, TARGET, visible=False)
        self._force = scene.add_arrows(
            "/rig/force", np.zeros((1, 2, 3)), BOUND, shaft_radius=0.003 * size, head_radius=0.008 * size,
            head_length=0.02 * size, visible=False,
        )  # fmt: skip

    def rest(self, model: CompiledModel) -> None:
        """Draw a model's arm without inputs."""
        inputs = np.zeros(model.layout.inputs)
        self._arm.show(nodes_in_g(model.robot, solve_statics(model, inputs).x), inputs)

    def show(self, moment: Moment, path: Path) -> None:
        """Draw a moment and the way to it."""
        if moment.nodes is not None:
            self._arm.show(moment.nodes, moment.inputs / self._limits)
        elif np.isfinite(moment.points).all():
            set_lines(self._backbone, polyline(backbone(self._base, moment.points)))
        tips = path.tips[np.isfinite(path.tips).all(axis=1)]
        if len(tips):
            set_lines(self._trace, polyline(tips, PIECES))
        self._target.visible = bool(np.isfinite(moment.target).all())
        self._target.position = moment.target
        pushed = bool(moment.force.any() and np.isfinite(moment.tip).all())
        self._force.visible = pushed
        if pushed:
            self._force.points = np.array([[moment.tip - METRES_PER_NEWTON * moment.force, moment.tip]])

    def hide(self) -> None:
        """Take it out of sight."""
        self._arm.hide()
        for handle in (self._backbone, self._trace, self._target, self._force):
            handle.visible = False


def describe_moment(moment: Moment, path: Path) -> str:
    """Describe a moment as Markdown."""
    x, y, z = (f"{1e3 * value + 0.0:.1f}" for value in moment.tip)
    which, since = "tracked tip" if moment.nodes is None else "true tip", path.time[-1] - path.time[0]
    lost = int((~np.isfinite(moment.points).all(axis=1)).sum())
    lines = [
        f"**{moment.time:.1f} s** · {which} x {x} · y {y} · z {z} mm",
        f"off its target: **{1e3 * moment.error:.1f} mm** now, {1e3 * path.rms:.1f} mm rms over the last {since:.0f} s",
    ]
    if moment.force.any():
        lines.append(f"▶ pushed with {np.linalg.norm(moment.force):.2g} N")
    if lost:
        lines.append(f"▲ the tracker has lost {lost} of {len(moment.points)} points")
    return "\n\n".join(lines)

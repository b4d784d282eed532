"""Shapes in viser's scene: nodes are added once, and only what has changed is sent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot
from tepm_opt.solvers.linear.gain import Actuation
from tepm_opt.studio.arm import KINDS, OperatingPoint
from tepm_opt.studio.shapes import GHOST, PLATE, PRESSURE, RING, TENSION, ArmShape, Color, arm_shape, nodes_in_g, quaternion

if TYPE_CHECKING:
    import viser

MUSCLE, TENDON, PLATE_EDGE, RING_EDGE = 0.011, 0.004, 0.004, 0.0015  # m, of an arm whose rings have a radius of 40 mm
FLOOR = (215, 218, 223)
NOWHERE = np.zeros((1, 2, 3), dtype=np.float32)


def line_node(scene: viser.SceneApi, name: str, thickness: float, color: Color = GHOST) -> viser.LineSegmentsHandle:
    """A node for lines of one colour, with none yet.

    Args:
        scene: viser's.
        name: of the node.
        thickness: of the lines in m.
        color: of the lines.
    """
    return scene.add_line_segments(name, NOWHERE, color, thickness=thickness, visible=False)


def set_lines(handle: viser.LineSegmentsHandle, points: np.ndarray) -> None:
    """Show pieces (pieces, 2, 3) in m in place of those that were there; nothing where there are none, or some are not known."""
    known = len(points) > 0 and bool(np.isfinite(points).all())
    handle.visible = known
    if known:
        handle.points = points.astype(np.float32)


class ArmNode:
    """An arm in the scene.

    Args:
        scene: viser's.
        name: of its node.
        layout: of its network.
        radius: of its rings in m, which lines are as thick for.
    """

    def __init__(self, scene: viser.SceneApi, name: str, layout: Layout, radius: float) -> None:
        self._layout, size = layout, radius / 0.04
        blank = np.zeros((layout.levels * layout.actuators, 2, 3), dtype=np.float32)  # viser keeps one colour for each end from the start
        colors = np.zeros(blank.shape, dtype=np.uint8)
        self._muscles, self._tendons = (
            scene.add_line_segments(f"/{name}/{part}", blank, colors, thickness=size * width, visible=False)
            for part, width in (("muscles", MUSCLE), ("tendons", TENDON))
        )
        self._plates = line_node(scene, f"/{name}/plates", size * PLATE_EDGE, PLATE)
        self._rings = line_node(scene, f"/{name}/rings", size * RING_EDGE, RING)

    def show(self, nodes: np.ndarray, used: np.ndarray, bound: np.ndarray | None = None) -> ArmShape:
        """Draw it; see `arm_shape`."""
        shape = arm_shape(self._layout, nodes, used, bound)
        self._muscles.colors, self._tendons.colors = shape.muscle_colors, shape.tendon_colors
        set_lines(self._muscles, shape.muscles)
        set_lines(self._tendons, shape.tendons)
        set_lines(self._plates, shape.plates)
        set_lines(self._rings, shape.rings)
        return shape

    def hide(self) -> None:
        """Take it out of sight."""
        for handle in (self._muscles, self._tendons, self._plates, self._rings):
            handle.visible = False


class Bench:
    """The arm under inputs, with its limits by name and G's ellipsoids at its tip.

    Args:
        scene: viser's.
        layout: of the network.
        radius: of its rings in m.
    """

    def __init__(self, scene: viser.SceneApi, layout: Layout, radius: float) -> None:
        self._layout = layout
        self._arm = ArmNode(scene, "arm", layout, radius)
        self._ellipsoids: dict[Actuation, viser.IcosphereHandle] = {  # one as a net, so that the other is seen inside it
            "pressure": scene.add_icosphere("/gain/pressure", 1.0, PRESSURE, wireframe=True, opacity=0.5, cast_shadow=False, visible=False),
            "tension": scene.add_icosphere("/gain/tension", 1.0, TENSION, opacity=0.6, cast_shadow=False, visible=False),
        }
        self._labels = [
            scene.add_label(f"/limits/{name}", name, visible=False, anchor="center-left", font_screen_scale=0.9)
            for name in layout.actuator_names
        ]

    def show(self, point: OperatingPoint, share: float, kinds: Sequence[Actuation] = KINDS) -> None:
        """Draw an operating point.

        Args:
            point: what to draw.
            share: of the inputs' ranges, that the ellipsoids are for.
            kinds: of which ellipsoids are shown.
        """
        held = point.held
        shape = self._arm.show(nodes_in_g(held.model.robot, held.x), held.inputs / held.model.input_max, point.bound)
        told = {limit.split()[0].partition("_")[2]: limit.replace("_", " ", 1) for limit in point.limits}
        for name, label, place in zip(self._layout.actuator_names, self._labels, shape.labels, strict=True):
            label.visible = name in told
            if name in told:
                label.text, label.position = told[name], place
        for kind, handle in self._ellipsoids.items():
            found = point.ellipsoid(kind, share) if kind in kinds else None
            handle.visible = found is not None
            if found is not None:
                x, y, z = np.maximum(found[0], 1e-4)
                handle.scale = (float(x), float(y), float(z))
                handle.wxyz, handle.position = quaternion(found[1]), held.tip

    def hide(self) -> None:
        """Take it out of sight."""
        self._arm.hide()
        for handle in (*self._labels, *self._ellipsoids.values()):
            handle.visible = False


def prepare(server: viser.ViserServer, robot: Robot) -> None:
    """A plain scene seen from the side: a floor under the base plate, the tracker frame's axes, lights that need no file.

    Args:
        server: viser's.
        robot: what will stand there.
    """
    scene, base, length = server.scene, np.array(robot.mount.base_position_m), robot.modules * robot.parameters.L_0
    up = robot.mount.rotation[:, 2]
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
    server.gui.main_panel.dock_right()
    scene.configure_environment_map(hdri=None)
    scene.configure_default_lights(True, cast_shadow=False)
    scene.add_light_ambient("/light", intensity=1.2)
    lowest = min(float(base[2]), float((base + 1.5 * length * up)[2]))
    scene.add_grid(
        "/floor", 3 * length, 3 * length, cell_size=0.1, section_size=0.5, position=(base[0], base[1], lowest), cell_color=FLOOR,
        section_color=FLOOR,
    )  # fmt: skip
    scene.add_frame("/G", axes_length=0.05, axes_radius=0.0015, origin_radius=0.003)
    middle = base + 0.55 * length * up
    server.initial_camera.look_at = middle
    server.initial_camera.position = middle + length * np.array([1.6, -2.2, 0.7])
    server.initial_camera.fov = np.radians(38.0)

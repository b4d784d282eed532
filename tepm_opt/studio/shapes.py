"""Lines that draw an arm, in G in m with their colours, made from nodes; numbers only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot

Color = tuple[int, int, int]
"""Red, green, blue, 0 … 255; a browser's lights make them paler."""
EMPTY: Color = (120, 128, 138)
PRESSURE: Color = (0, 55, 145)
TENSION: Color = (180, 65, 0)
BOUND: Color = (190, 0, 20)
PLATE: Color = (48, 52, 58)
RING: Color = (150, 156, 164)
GHOST: Color = (150, 156, 164)
MEASURED: Color = (27, 127, 75)
GAP: Color = (140, 30, 140)
TARGET: Color = (25, 25, 25)
FAINT = 0.5  # exponent of the used part of a range, so that a little of it can be seen
OUTSIDE = 1.28  # of a muscle's distance from the backbone, at which its tendon is drawn


@dataclass(frozen=True, eq=False)
class ArmShape:
    """An arm as straight pieces of lines between two points in G, (pieces, 2, 3) in m each.

    Attributes:
        muscles, tendons: segment by segment from the base, an actuator after the other in each.
        plates, rings: around the levels that end a module, and around the others.
        muscle_colors, tendon_colors: by pressure and tension, red where a limit binds, (pieces, 2, 3), uint8.
        labels: where an actuator's name would stand, (modules · actuators, 3) in m.
    """

    muscles: np.ndarray
    tendons: np.ndarray
    plates: np.ndarray
    rings: np.ndarray
    muscle_colors: np.ndarray
    tendon_colors: np.ndarray
    labels: np.ndarray

    def __repr__(self) -> str:
        return f"ArmShape({len(self.muscles)} pieces of muscle)"


def nodes_in_g(robot: Robot, x: np.ndarray) -> np.ndarray:
    """Nodes in G, (…, n + 1, actuators, 3) in m, from levels in the base frame, (…, n + 1, 3 · actuators)."""
    nodes = np.asarray(x).reshape(*np.shape(x)[:-1], -1, 3)
    return nodes @ robot.mount.rotation.T + np.array(robot.mount.base_position_m)


def arm_shape(layout: Layout, nodes: np.ndarray, used: np.ndarray, bound: np.ndarray | None = None) -> ArmShape:
    """An arm as lines.

    Args:
        layout: of its network.
        nodes: in G, (n + 1, actuators, 3) in m.
        used: inputs over their ranges, (2 · modules · actuators,), 0 … 1.
        bound: actuators at a limit, (modules · actuators,) of bool; none where absent.
    """
    bound = np.zeros(layout.inputs // 2, dtype=bool) if bound is None else bound
    centres = nodes.mean(axis=1, keepdims=True)
    outer = centres + OUTSIDE * (nodes - centres)
    pressure, tension = np.split(np.clip(np.nan_to_num(used), 0, 1), 2)
    around = np.argsort(np.mod(layout.angles, 2 * np.pi))
    loops = np.stack([nodes[:, around], nodes[:, np.roll(around, -1)]], axis=2)
    plates = loops[:: layout.segments].reshape(-1, 2, 3)
    rings = np.delete(loops, np.arange(0, layout.levels + 1, layout.segments), axis=0).reshape(-1, 2, 3)
    middles = outer.reshape(layout.levels + 1, -1, 3)[layout.segments // 2 :: layout.segments][: layout.modules]
    return ArmShape(
        _join_levels(nodes), _join_levels(outer), plates, rings, _colors(layout, pressure, PRESSURE, bound),
        _colors(layout, tension, TENSION, bound), middles.reshape(-1, 3),
    )  # fmt: skip


def polyline(points: np.ndarray, count: int | None = None) -> np.ndarray:
    """A line through points (n, 3) in m as pieces (n − 1, 2, 3), or as so many: some left out, or empty ones at its end."""
    if count is not None:
        places = np.linspace(0, len(points) - 1, min(count + 1, len(points))).round().astype(int)
        points = points[np.append(places, np.full(count + 1 - len(places), places[-1]))]
    return np.stack([points[:-1], points[1:]], axis=1)


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """The unit quaternion (w, x, y, z) of a rotation matrix (3, 3)."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return np.array([w, x, y, z])


def _join_levels(nodes: np.ndarray) -> np.ndarray:
    return np.stack([nodes[:-1], nodes[1:]], axis=2).reshape(-1, 2, 3)


def _colors(layout: Layout, share: np.ndarray, full: Color, bound: np.ndarray) -> np.ndarray:
    """Colours of pieces by the used share of each actuator, (modules · actuators,)."""
    empty = np.array(EMPTY)
    mixed = empty + share[:, None] ** FAINT * (np.array(full) - empty)
    colors = np.where(bound[:, None], BOUND, mixed).round().astype(np.uint8).reshape(layout.modules, layout.actuators, 3)
    return np.repeat(np.repeat(colors, layout.segments, axis=0).reshape(-1, 1, 3), 2, axis=1)

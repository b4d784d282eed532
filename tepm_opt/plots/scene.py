"""Pictures of a moving robot: what stands still is drawn once, the arm is put on it for each picture."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from tepm_opt.plots.palette import GOOD
from tepm_opt.solvers.mechanics.simulate import Simulation

WIDTH, HEIGHT, DPI = 720, 640, 100  # pixels; both even, as films need
COLOURS = colormaps["viridis_r"].resampled(48)
EDGE, RING, PLATE, FLOOR = "#30343a", "#8d9299", "#c3c7cd", "#cfcfcf"
MUSCLE, OUTLINE, THIN = 5.0, 6.6, 0.8  # points
ELEVATION, AZIMUTH = 18.0, -33.0  # degrees, of the eye
TICKS, INNER = 5, 0.92  # on the longest axis; part of an axis that has ticks, so that those of two axes do not meet in a corner
AREA = (0.03, 0.03, 0.80, 0.89)  # of the robot in the picture: left, bottom, width, height
SCALE_STEP = 50.0  # kPa, to which the end of the colour scale is rounded up
NARROWEST = 0.5  # of the longest axis, so that a robot that hardly moves has room for its labels


class Scene:
    """A simulated robot, seen from one side, in axes that hold the whole motion.

    Args:
        simulation: with at least one instant.
        note: written beside the time.

    Attributes:
        nodes: of the network in G, (instants, n + 1, actuators, 3) in mm.
    """

    def __init__(self, simulation: Simulation, note: str = "") -> None:
        robot, self._layout, self._time = simulation.model.robot, simulation.model.layout, simulation.setpoints.time
        self._base, self._note = 1e3 * np.array(robot.mount.base_position_m), note
        shape = (len(self._time), self._layout.levels + 1, self._layout.actuators, 3)
        self.nodes = 1e3 * simulation.levels.reshape(shape) @ robot.mount.rotation.T + self._base
        self._tip = 1e3 * simulation.tip
        self._pressure = 1e-3 * simulation.setpoints.inputs[:, : self._layout.inputs // 2]
        highest = np.ceil(self._pressure.max() / SCALE_STEP) * SCALE_STEP
        self._norm = Normalize(0.0, min(max(highest, SCALE_STEP), 1e-3 * robot.actuation.pressure_max_Pa))
        self._figure = Figure(figsize=(WIDTH / DPI, HEIGHT / DPI), dpi=DPI)
        self._canvas = FigureCanvasAgg(self._figure)
        self._axes: Any = self._figure.add_axes(AREA, projection="3d")
        self._still_parts(robot.name)
        self._canvas.draw()
        self._still = self._canvas.copy_from_bbox(self._figure.bbox)
        self._projection = self._axes.get_proj()
        self._moving = self._moving_parts()
        self._tip_seen, _ = self._project(self._tip)
        self._pieces, self._widths, self._frozen = self._drawn_pieces()

    def image(self, instant: int) -> np.ndarray:
        """The picture at an instant, (HEIGHT, WIDTH, 3), uint8; read it before the next one is drawn."""
        shadow, trace, arm, dot, clock = self._moving
        shadow.set_data(*self._project(self._shadow(instant))[0].T)
        trace.set_data(*self._tip_seen[: instant + 1].T)
        dot.set_data(*self._tip_seen[instant : instant + 1].T)
        clock.set_text(f"{self._time[instant]:6.2f} s{self._note}")
        self._set_arm(arm, instant)
        renderer = self._canvas.get_renderer()
        self._canvas.restore_region(self._still)
        for part in self._moving:
            part.draw(renderer)
        return np.asarray(self._canvas.buffer_rgba())[..., :3]

    def _still_parts(self, name: str) -> None:
        axes, everything = self._axes, self.nodes.reshape(-1, 3)
        low, high = np.minimum(everything.min(axis=0), self._base), np.maximum(everything.max(axis=0), self._base)
        span = np.maximum(1.06 * (high - low), NARROWEST * (high - low).max())
        low = (low + high - span) / 2
        for k, label in enumerate("xyz"):
            getattr(axes, f"set_{label}lim")(low[k], low[k] + span[k])
            getattr(axes, f"set_{label}label")(f"{label} in mm", labelpad=12 if label == "z" else 8)
            count = TICKS if span[k] > 0.7 * span.max() else TICKS - 1
            ticks = MaxNLocator(count, steps=[1, 2, 4, 5, 10]).tick_values(low[k], low[k] + span[k])
            inner = np.abs((ticks - low[k]) / span[k] - 0.5) < INNER / 2
            getattr(axes, f"set_{label}ticks")(ticks[inner])
        axes.tick_params(axis="z", pad=6)
        axes.view_init(elev=ELEVATION, azim=AZIMUTH)
        self._fit(span)
        self._floor = low[2]
        bar = self._figure.add_axes((0.88, 0.2, 0.022, 0.55))
        self._figure.colorbar(ScalarMappable(self._norm, COLOURS), cax=bar, label="commanded pressure in kPa")
        self._figure.text(0.97, 0.95, f"{name}, frame G", fontsize=11, ha="right")

    def _fit(self, span: np.ndarray) -> None:
        """Size and shift the axes so that they, with their labels, fill their place in the picture."""
        left, bottom, width, height = AREA
        centre, zoom = np.array([left + width / 2, bottom + height / 2]), 1.0
        for _ in range(3):  # labels do not grow with the axes
            self._axes.set_box_aspect(span, zoom=zoom)
            self._canvas.draw()
            seen = self._axes.get_tightbbox(self._canvas.get_renderer()).transformed(self._figure.transFigure.inverted())
            zoom *= min(width / seen.width, height / seen.height)
            here = self._axes.get_position(original=True)
            x, y = centre - [(seen.x0 + seen.x1) / 2, (seen.y0 + seen.y1) / 2] + [here.x0, here.y0]
            self._axes.set_position((x, y, here.width, here.height))

    def _moving_parts(self) -> tuple[Any, ...]:
        """Shadow of the backbone, trace of the tip, arm, tip, clock: from back to front."""
        arm = PolyCollection([], closed=False, capstyle="round", joinstyle="round")
        lines = (
            Line2D([], [], color=FLOOR, linewidth=3.0),
            Line2D([], [], color=GOOD.color, linewidth=1.2),
            Line2D([], [], color=GOOD.color, marker="o", markersize=6.5, markeredgecolor="white"),
        )
        parts: tuple[Artist, ...] = (*lines[:2], arm, lines[2])
        for part in parts:
            part.set_transform(self._axes.transData)
            part.set_figure(self._figure)
        return (*parts, self._figure.text(0.03, 0.95, "", fontsize=13, family="monospace"))

    def _project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places in the picture's data coordinates, (…, 2), and depths, larger is farther, (…)."""
        seen = points @ self._projection[:3, :3].T + self._projection[:3, 3]
        weight = points @ self._projection[3, :3] + self._projection[3, 3]
        return seen[..., :2] / weight[..., None], seen[..., 2] / weight

    def _shadow(self, instant: int) -> np.ndarray:
        """The centres of the levels on the floor, (n + 1, 3) in mm."""
        shadow = self.nodes[instant].mean(axis=1)
        shadow[:, 2] = self._floor
        return shadow

    def _drawn_pieces(self) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
        """The nodes (by flat number) of all plates, rings and pieces of muscles, their widths in points and their plain colours.

        A plate or ring is closed by its first node.
        """
        n, count = self._layout.levels, self._layout.actuators
        around = np.argsort(np.mod(self._layout.angles, 2 * np.pi))
        loop = np.append(around, around[0])
        pieces = [level * count + loop for level in range(n + 1)]
        pieces += [np.array([level * count + j, (level + 1) * count + j]) for level in range(n) for j in range(count)]
        plate = [level % self._layout.segments == 0 for level in range(n + 1)]
        widths = np.array([1.5 if is_plate else THIN for is_plate in plate] + [MUSCLE] * (n * count))
        colours = np.array([to_rgba(EDGE if is_plate else RING) for is_plate in plate] + [to_rgba(EDGE)] * (n * count))
        return pieces, widths, colours

    def _set_arm(self, arm: PolyCollection, instant: int) -> None:
        """Put plates, rings and muscles into the collection, the farthest first; each piece of muscle has a dark one under it."""
        n, count, segments = self._layout.levels, self._layout.actuators, self._layout.segments
        places, depths = self._project(self.nodes[instant].reshape(-1, 3))
        depth = np.array([depths[piece].mean() for piece in self._pieces])
        edges, faces, widths = self._frozen.copy(), np.zeros((len(self._pieces), 4)), self._widths
        faces[: n + 1 : segments] = to_rgba(PLATE, 0.85)
        by_muscle = COLOURS(self._norm(self._pressure[instant])).reshape(self._layout.modules, 1, count, 4)
        edges[n + 1 :] = np.broadcast_to(by_muscle, (self._layout.modules, segments, count, 4)).reshape(-1, 4)
        order = np.argsort(-depth, kind="stable")
        doubled = np.repeat(order, np.where(order > n, 2, 1))
        under = np.append(doubled[1:] == doubled[:-1], False)
        arm.set_verts([places[self._pieces[k]] for k in doubled], closed=False)
        arm.set_facecolor(faces[doubled])  # type: ignore[arg-type]
        arm.set_edgecolor(np.where(under[:, None], self._frozen[doubled], edges[doubled]))  # type: ignore[arg-type]
        arm.set_linewidth(np.where(under, OUTLINE, widths[doubled]))  # type: ignore[arg-type]

"""Draw docs/images/gallery_*.png, the robots of docs/how-to/own_robot.md at rest and bent: `python docs/gallery.py [ROBOT …]`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tepm_opt import CompiledModel, Equilibrium, compile_model, path_for, solve_ik, solve_statics

ROBOTS = ("one_module", "hanging", "four_muscles", "slim")
IMAGES = Path(__file__).resolve().parent / "images"
SIZE, DPI = (4.4, 4.0), 90  # inches; the picture is small
ELEVATION, AZIMUTH = 14.0, -58.0  # degrees, of the eye
ACROSS = np.array([-np.sin(np.deg2rad(AZIMUTH)), np.cos(np.deg2rad(AZIMUTH)), 0.0])
REST, BENT, PATH = "#9aa0a6", "#14507d", "#c0561a"


def nodes(at: Equilibrium) -> np.ndarray:
    """All nodes in G, (n + 1, actuators, 3) in mm."""
    mount = at.model.robot.mount
    return 1e3 * (np.asarray(at.x).reshape(-1, at.model.layout.actuators, 3) @ mount.rotation.T + np.array(mount.base_position_m))


def arm(axes: Any, at: Equilibrium, colour: str, label: str) -> None:
    """Muscles as lines, plates as polygons round them."""
    levels, every = nodes(at), at.model.layout.segments
    order = np.argsort(np.mod(at.model.layout.angles, 2 * np.pi))
    for k, muscle in enumerate(levels.swapaxes(0, 1)):
        axes.plot(*muscle.T, color=colour, lw=2.2, label=label if k == 0 else None, solid_capstyle="round")
    for plate in levels[::every]:
        axes.plot(*np.vstack([plate[order], plate[order[:1]]]).T, color=colour, lw=1.4)


def draw(model: CompiledModel) -> Figure:
    """A robot at rest and on its circle, from a side that shows both."""
    figure = Figure(figsize=SIZE, dpi=DPI)
    axes: Any = figure.add_axes((0.04, 0.10, 0.80, 0.89), projection="3d")
    path = path_for(model, "circle", points=48).positions
    bent = solve_ik(model, path[int(np.argmax(path @ ACROSS))]).equilibrium
    arm(axes, solve_statics(model, np.zeros(model.layout.inputs)), REST, "at rest")
    arm(axes, bent, BENT, "on its circle")
    axes.plot(*(1e3 * np.vstack([path, path[:1]])).T, color=PATH, lw=1.2, ls="--", label="circle")
    corners = np.vstack([nodes(bent).reshape(-1, 3), 1e3 * path, 1e3 * np.array(model.robot.mount.base_position_m)[None]])
    middle, reach = (corners.max(axis=0) + corners.min(axis=0)) / 2, np.ptp(corners, axis=0)
    wide = np.maximum(reach, 0.45 * reach.max()) * 1.05
    for axis, centre, span in zip("xyz", middle, wide, strict=True):
        getattr(axes, f"set_{axis}lim")(centre - span / 2, centre + span / 2)
        getattr(axes, f"set_{axis}label")(f"{axis} (mm)", fontsize=8)
    axes.set_box_aspect(wide)
    axes.tick_params(labelsize=7, pad=0)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(4))
    axes.view_init(elev=ELEVATION, azim=AZIMUTH)
    axes.legend(loc="upper left", fontsize=8, frameon=False)
    return figure


def main() -> None:
    """Draw the robots that are named, or all."""
    for name in sys.argv[1:] or ROBOTS:
        figure = draw(compile_model(name))
        FigureCanvasAgg(figure).print_png(IMAGES / f"gallery_{name}.png")


if __name__ == "__main__":
    main()

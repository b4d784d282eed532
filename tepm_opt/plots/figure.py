"""Style of figures, and writing them. Matplotlib without a screen; a figure is written whole or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tepm_opt.data.files import atomic_path
from tepm_opt.solvers.kinematics.backbone import backbone
from tepm_opt.solvers.mechanics.statics import Equilibrium

STYLE = {"dpi": 130, "layout": "constrained"}

Figures = Mapping[str, Figure | None]
"""Figures by their names, which are those of their files; None where an earlier one shall go."""


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG.

    Raises:
        InputError: the folder cannot be written to.
    """
    canvas = FigureCanvasAgg(figure)
    with atomic_path(path) as temporary:
        canvas.print_png(temporary, metadata={"Software": None})  # `savefig` would draw twice


def save_figures(figures: Figures, folder: str | Path) -> dict[str, Path]:
    """Write figures as PNG into a folder that is there; the file of one that is None goes.

    Returns:
        The files by the figures' names.

    Raises:
        InputError: the folder cannot be written to.
    """
    written = {}
    for name, figure in figures.items():
        path = Path(folder) / f"{name}.png"
        if figure is None:
            path.unlink(missing_ok=True)
        else:
            save(figure, path)
            written[name] = path
    return written


def backbone_mm(at: Equilibrium) -> np.ndarray:
    """Backbone of an equilibrium in G in mm, (points on it, 3)."""
    return 1e3 * backbone(np.array(at.model.robot.mount.base_position_m), at.points)

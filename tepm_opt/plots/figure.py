"""What figures share: style, and writing them. Matplotlib without a screen; a figure is written whole or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tepm_opt.data.files import atomic_path
from tepm_opt.solvers.backbone import backbone
from tepm_opt.solvers.statics import Equilibrium

STYLE = {"dpi": 130, "layout": "constrained"}


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG.

    Raises:
        InputError: the folder cannot be written to.
    """
    canvas = FigureCanvasAgg(figure)
    with atomic_path(path) as temporary:
        canvas.print_png(temporary, metadata={"Software": None})  # `savefig` would draw twice


def backbone_mm(at: Equilibrium) -> np.ndarray:
    """Backbone of an equilibrium in G in mm, (points on it, 3)."""
    return 1e3 * backbone(np.array(at.model.robot.mount.base_position_m), at.points)

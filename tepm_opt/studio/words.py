"""Text of the studio beside the picture, as Markdown."""

from __future__ import annotations

import numpy as np

from tepm_opt.outcome import Ending
from tepm_opt.solvers.numerics.text import quantity
from tepm_opt.studio.arm import KINDS, OperatingPoint

BEYOND = 1e-3  # condition above its inverse at which a direction counts as not driven


def describe_operating_point(point: OperatingPoint, off: float) -> str:
    """Describe an operating point as Markdown: where the tip is, how that came, which limits bind, how strongly inputs drive it.

    Args:
        point: the operating point.
        off: how far the tip is from there with inputs on the actuators' grids, in m; NaN where unknown.
    """
    return "\n\n".join([_place(point), _came(point), _limits(point), *_gains(point), *_grids(off)])


def _place(point: OperatingPoint) -> str:
    x, y, z = (f"{1e3 * value + 0.0:.1f}" for value in np.round(point.held.tip, 7))
    return f"**Tip** x {x} · y {y} · z {z} mm, plate tilted by {np.degrees(point.held.tip_tilt):.0f}°"


def _came(point: OperatingPoint) -> str:
    if not point.held.solved:
        reached = f"; a stable arm takes {100 * point.held.reached:.0f} % of these inputs" if 0 < point.held.reached < 1 else ""
        return f"✗ **{point.held.outcome.ending}**: {point.held.outcome.message}{reached}"
    if point.asked is None:
        return "✓ **stable** under the inputs set"
    if point.asked.solved:
        return "✓ **reached**"
    if point.asked.outcome.ending is Ending.OUT_OF_REACH:
        return f"▲ **out of reach**: this is the nearest point, **{1e3 * point.asked.miss:.1f} mm** from where you want it"
    return f"✗ **{point.asked.outcome.ending}**, the arm stays: {point.asked.outcome.message}"


def _limits(point: OperatingPoint) -> str:
    if names := [name.replace("_", " ", 1) for name in point.limits]:
        return f"■ **{len(names)} limit{'s bind' if len(names) > 1 else ' binds'}** (red): {', '.join(names)}"
    if point.asked is not None and point.asked.outcome.ending is Ending.OUT_OF_REACH:
        return "No limit binds: the stable branch may end there."
    return "No limit binds."


def _gains(point: OperatingPoint) -> list[str]:
    if point.gain is None:
        return []
    head = "**G**: the tip's way over an actuation's full range, singular values in mm\n\n"
    rows = ["| | largest | middle | smallest |", "|:---|---:|---:|---:|"]
    for kind in KINDS:
        values = point.gain.singular_values(kind)
        lost = " (not driven)" if values[0] > 0 and values[-1] < BEYOND * values[0] else ""
        rows.append(f"| {kind} | " + " | ".join(f"{1e3 * value:.0f}" for value in values) + f"{lost} |")
    return [head + "\n".join(rows)]


def _grids(off: float) -> list[str]:
    return [f"On the actuators' grids the tip is {quantity(off, 'm')} off."] if np.isfinite(off) else []

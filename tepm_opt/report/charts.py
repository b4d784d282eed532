"""Figures that a page's script draws: curves that can be zoomed, a robot that can be turned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from tepm_opt.data.metrics import shape_error
from tepm_opt.data.setpoints import AXES
from tepm_opt.discrepancy.state import Discovery
from tepm_opt.jobs.closed_loop import ClosedLoop
from tepm_opt.jobs.ik import IkRun
from tepm_opt.plots.discrepancy import (
    SMALLEST_SPAN,
    SPREAD,
    choose_horizontal_axis,
    error_name,
    most_corrected,
    select_comparison,
    unit_shown,
)
from tepm_opt.plots.figure import backbone_mm
from tepm_opt.plots.palette import GOOD, MEASURED, MODELS, NOISE, ROBOT, TARGET, Role, controller

MOST = 3000  # places along a curve; of more, the smallest and the largest value of each stretch
PLACES = 24  # of a backbone


class Chart(Protocol):
    """A figure that the script draws."""

    @property
    def title(self) -> str:
        """Heading above the figure."""
        ...

    def data(self) -> dict[str, Any]:
        """Convert it to plain data for the script."""
        ...


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve of a panel: its name, how it is drawn, its values, and whether they are points that are not joined."""

    name: str
    role: Role
    values: np.ndarray
    points: bool = False


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves over one quantity.

    Attributes:
        x: (n,), rising.
        across, label: names of the axes with their units.
        curves: (n,) values each.
        title: above it.
        logarithmic: whether the other axis is.
        least: the smallest span of the other axis, or, of a logarithmic one, its smallest value.
    """

    x: np.ndarray
    across: str
    label: str
    curves: Sequence[Curve]
    title: str = ""
    logarithmic: bool = False
    least: float = 0.0

    def data(self) -> dict[str, Any]:
        """Convert it to plain data for the script."""
        rows = _downsample(self.x, [curve.values for curve in self.curves])
        series = [
            {"name": curve.name, "color": curve.role.color, "line": curve.role.line, "marker": curve.role.marker}
            | {"points": curve.points, "values": _plain(values)}
            for curve, values in zip(self.curves, rows[1:], strict=True)
        ]
        limits = {"log": self.logarithmic, "least" if self.logarithmic else "span": self.least}
        return {"x": _plain(rows[0]), "across": self.across, "label": self.label, "title": self.title, "series": series, **limits}


@dataclass(frozen=True, eq=False)
class Curves:
    """Panels one below the other, which are zoomed together.

    Attributes:
        title: above them.
        alt: what is seen, for those who do not see it.
        panels: from above.
        view: what is shown first, as parts of the whole.
    """

    title: str
    alt: str
    panels: Sequence[Panel]
    view: tuple[float, float] = (0.0, 1.0)

    def data(self) -> dict[str, Any]:
        """Convert it to plain data for the script."""
        return {"alt": self.alt, "view": self.view, "panels": [panel.data() for panel in self.panels]}


@dataclass(frozen=True, eq=False)
class Arms:
    """A robot at several points, which can be turned.

    Attributes:
        title: above it.
        alt: what is seen, for those who do not see it.
        backbones: in mm, (places, 3) each.
        targets: in mm, (points, 3).
    """

    title: str
    alt: str
    backbones: Sequence[np.ndarray]
    targets: np.ndarray

    def data(self) -> dict[str, Any]:
        """Convert it to plain data for the script."""
        arms = [[_plain(place) for place in arm[_space_rows(len(arm), PLACES)]] for arm in self.backbones]
        roles = {name: {"color": role.color, "line": role.line} for name, role in (("robot", ROBOT), ("target", TARGET), ("reached", GOOD))}
        return {"alt": self.alt, "arms": arms, "targets": [_plain(target) for target in self.targets], **roles}


def robot_chart(run: IkRun) -> dict[str, Chart]:
    """The robot at every point that is solved; nothing where none is."""
    curves = [backbone_mm(at) for at in run.reached if at.solved]
    targets = 1e3 * run.trajectory.positions
    targets = np.vstack([targets, targets[:1]]) if run.trajectory.closed else targets
    title = "The robot at every point. Drag or use the arrows to turn it; choose a point with the slider."
    alt = f"Backbone of {run.model.robot.name} at {len(curves)} points of the path, and the path itself, in frame G"
    return {"robot": Arms(title, alt, curves, targets)} if curves else {}


def distance_chart(loops: Mapping[str, ClosedLoop]) -> dict[str, Chart]:
    """Distance of the tip from its target over time, with each controller; a panel each where they differ in their samples."""
    if not loops:
        return {}
    longest = max(loops.values(), key=lambda loop: len(loop.time))
    curves = []
    for name, loop in loops.items():
        far = 1e3 * np.linalg.norm(loop.errors(bool(np.isfinite(loop.truth).any())), axis=1)
        curves.append(Curve(name, controller(loop.setup.controller), np.interp(longest.time, loop.time, far, right=np.nan)))
    panel = Panel(longest.time, "time in s", "distance in mm", curves, logarithmic=True, least=0.05)
    counted = longest.time[longest.counted]
    when = f" What counts begins at {counted[0]:.3g} s." if len(counted) else ""
    alt = "Distance of the tip from its target over time: " + ", ".join(loops)
    return {"distance": Curves(f"Distance of the tip from its target.{when}", alt, [panel])}


def discovery_charts(result: Discovery) -> dict[str, Chart]:
    """Errors over time of every model on every run, and the tip, measured and modelled, where correction matters most."""
    seen = select_comparison(result)
    factor, shown = unit_shown(seen.unit)
    floor, panels = factor * seen.floor, []
    for k, run in enumerate(seen.runs):
        x, label, mark = choose_horizontal_axis(run)
        errors = {name: factor * shape_error(run.points, each[k]) for name, each in seen.predictions.items()}
        curves = [Curve(name, MODELS[name], values, mark != "-") for name, values in errors.items()]
        curves.append(Curve("noise floor", NOISE, np.full(len(x), floor)))
        finite = np.concatenate([values[np.isfinite(values)] for values in errors.values()])
        far = floor > 0 and len(finite) > 0 and float(np.median(finite)) > SPREAD * floor
        panels.append(Panel(x, label, f"{error_name(seen.unit)} in {shown}", curves, run.file, far, 0.3 * floor if far else 0.0))
    over_time = Curves("Error of every model over time", "Error of every model over time on every run, beside the noise floor", panels)
    k, rows, axis = most_corrected(seen.runs, seen.predictions)
    run = seen.runs[k]
    x, label, mark = choose_horizontal_axis(run)
    measured = factor * run.points[:, -1, axis]
    modelled = {name: factor * each[k][:, -1, axis] for name, each in seen.predictions.items()}
    of = f"{seen.of} {AXES[axis]}" if run.points.shape[-1] > 1 else seen.of
    above = [
        Curve("measured", MEASURED, measured, True),
        *(Curve(name, MODELS[name], each, mark != "-") for name, each in modelled.items()),
    ]
    below = [Curve(name, MODELS[name], each - measured, mark != "-") for name, each in modelled.items()]
    least = SMALLEST_SPAN if seen.unit == "m" else 0.0
    pair = [
        Panel(x, label, f"{of} in {shown}", above, f"{run.file}: {of}", least=least),
        Panel(x, label, f"difference in {shown}", below, "modelled − measured", least=least),
    ]
    tip = Curves(f"{of} in {run.file}, where correction matters most", f"{of} over time, measured and by every model", pair, _part(x, rows))
    return {"over_time": over_time, "tip": tip}


def _part(x: np.ndarray, rows: slice) -> tuple[float, float]:
    """Find the span of rows as fractions of the whole axis, first and last."""
    first, last = (float(x[row] - x[0]) / float(x[-1] - x[0] or 1) for row in (rows.start, rows.stop - 1))
    return first, max(last, first + 1e-3)


def _plain(values: np.ndarray) -> list[float | None]:
    """Numbers of five digits for JSON, None where there is none."""
    return [float(f"{value:.5g}") if np.isfinite(value) else None for value in values]


def _space_rows(count: int, most: int) -> np.ndarray:
    """Rows so that no more than these are left, the first and last among them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def _downsample(x: np.ndarray, curves: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Reduce an axis and its curves to at most `MOST` rows: of each stretch the smallest and the largest value."""
    if len(x) <= MOST:
        return [x, *curves]
    starts = np.linspace(0, len(x), MOST // 2 + 1).astype(int)[:-1]
    kept = []
    for values in curves:
        with_none = np.isfinite(values)
        low = np.minimum.reduceat(np.where(with_none, values, np.inf), starts)
        high = np.maximum.reduceat(np.where(with_none, values, -np.inf), starts)
        pairs = np.column_stack([low, high]).ravel()
        kept.append(np.where(np.isfinite(pairs), pairs, np.nan))
    middles = (starts + np.append(starts[1:], len(x))) // 2
    return [np.column_stack([x[starts], x[middles]]).ravel(), *kept]

"""Colours by meaning, the same in every figure and page; a line style or a marker says it again without colour.

Roles that meet in one panel (`TOGETHER`) stay apart for readers who do not see green (deuteranopia) and on a grey printer: a test holds
them to that. Every colour has a contrast of 3 and more against white.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tepm_opt.models.layout import Layout


@dataclass(frozen=True)
class Role:
    """Colour, line and marker of something drawn.

    Attributes:
        color: as matplotlib and CSS take it.
        line: style of its lines, as matplotlib names it.
        marker: of its points.
    """

    color: str
    line: str = "-"
    marker: str = "o"

    @property
    def lined(self) -> dict[str, Any]:
        """Arguments of matplotlib for a line."""
        return {"color": self.color, "linestyle": self.line}

    @property
    def marked(self) -> dict[str, Any]:
        """Arguments of matplotlib for points that are not joined."""
        return {"color": self.color, "linestyle": "none", "marker": self.marker}


TARGET = Role("#000000", "--", "+")
MEASURED = Role("#949494", "-", ".")
NOISE = Role("#000000", ":", "|")
LIMIT = Role("#000000", ":", "_")

NOMINAL = Role("#bd571f", "--", "s")
RECALIBRATED = Role("#902e8b", "-.", "^")
CORRECTED = Role("#0a4345", "-", "o")
BLACK_BOX = Role("#339dd0", ":", "D")

PRESSURE = Role("#2656b5", "-", "o")
TENSION = Role("#db7310", "--", "s")
BOTH = Role("#000000", ":", "D")

ROBOT = Role("#222c37", "-", "s")
GOOD = Role("#098a3f", "-", "o")
BAD = Role("#9a0110", "--", "X")
UNJUDGED = Role("#8392bf", "-", "D")
OBSTACLE = Role("#cfae9b", "-", "s")

MODELS: Mapping[str, Role] = {
    "noise floor": NOISE, "nominal": NOMINAL, "recalibrated": RECALIBRATED, "corrected": CORRECTED, "black box": BLACK_BOX,
}  # fmt: skip
INPUTS: Mapping[str, Role] = {"pressure": PRESSURE, "tension": TENSION}
AXES: Mapping[str, Role] = {"x": Role("#7b4558", "-", "o"), "y": Role("#5f7949", "--", "s"), "z": Role("#9e81d1", "-.", "^")}

CONTROLLERS: Mapping[str, Role] = {
    "mpc": Role("#480390", "-", "o"),
    "lqg": Role("#990153", ":", "D"),
    "mode2": Role("#11867b", "--", "s"),
    "mode1": Role("#ae8d4e", "-.", "^"),
}
OWN_CONTROLLER = Role("#2f6b00", "-", "v")
"""Style of controllers that are not the package's own."""

ACTUATORS = ("#714201", "#0b72a5", "#bd7798", "#123e01", "#907d07", "#655394")
LINES, MARKERS = ("-", "--", ":", "-."), ("o", "s", "^", "D")

TOGETHER: Mapping[str, Sequence[Role]] = {
    "models": tuple(MODELS.values()),
    "models beside what was measured": (MEASURED, NOMINAL, RECALIBRATED, CORRECTED),
    "controllers": (TARGET, *CONTROLLERS.values()),
    "a loop": (TARGET, MEASURED, CONTROLLERS["mpc"]),
    "coarse and fine": (PRESSURE, TENSION, BOTH),
    "axes": tuple(AXES.values()),
    "a robot on its way": (TARGET, ROBOT, GOOD, BAD),
    "judged": (GOOD, BAD, UNJUDGED, TARGET),
    "actuators of a module": tuple(Role(color) for color in ACTUATORS[:3]),
}
"""Roles that meet in one panel."""


def controller(name: str) -> Role:
    """Find the role of a controller's lines."""
    return CONTROLLERS.get(name, OWN_CONTROLLER)


def actuator(number: int) -> str:
    """Colour of an actuator of a module; modules have styles."""
    return ACTUATORS[number % len(ACTUATORS)]


def channel(layout: Layout, number: int) -> Role:
    """Find the role of an actuator: its colour by its place in the module, line and marker by the module."""
    module, place = divmod(number, layout.actuators)
    return Role(actuator(place), LINES[module % len(LINES)], MARKERS[module % len(MARKERS)])

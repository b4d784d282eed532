"""`tepm hw monitor`: what board and tracker say, live."""

from __future__ import annotations

import time
from contextlib import nullcontext
from typing import Annotated

import numpy as np
import typer
from rich.console import Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from tepm_opt.cli.common import SOLVED, RobotOption, stdout
from tepm_opt.cli.hw import shared as hw_shared
from tepm_opt.cli.hw.shared import safely, say
from tepm_opt.hw.board.calibration import Calibration
from tepm_opt.hw.board.protocol import State
from tepm_opt.hw.service.line import LOG
from tepm_opt.hw.service.monitor import PERIOD, Monitor, MonitorReading
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot, load_robot


def monitor(
    port: Annotated[str, typer.Argument(metavar="PORT", help="Serial port, PORT or PORT@BAUD, or log:FILE to play a link log back.")],
    seconds: Annotated[float | None, typer.Option("--seconds", min=0.1, help="End after so long; without it, with Ctrl-C.")] = None,
    robot: RobotOption = None,
) -> int:
    """Show state, pressures, tensions, motors, tracker and line. Never arms; opens the port again when the cable was out.

    Opening the port restarts the board, so a robot that another program moves cannot be looked at.
    """
    found = load_robot(robot or "kang2017")
    view = _View(found)

    def work() -> int:
        tracker = None if port.startswith(LOG) else hw_shared.open_tracker(found)
        watch = None
        try:
            watch = Monitor(lambda: hw_shared.open_line(port), tracker)
            _show(watch, view, seconds)
        finally:
            if watch is not None:
                watch.close()
            if tracker is not None:
                tracker.close()
        return SOLVED

    return safely(work, "the board was not armed", "the board was not armed")


def _show(watch: Monitor, view: _View, seconds: float | None) -> None:
    terminal, due, last, before = stdout.is_terminal, 0.0, None, None
    with Live(console=stdout, refresh_per_second=10, transient=False) if terminal else nullcontext() as live:
        for look in watch:
            last = look
            if live is not None:
                live.update(view.table(look))
                time.sleep(PERIOD if watch.recorded else 0.0)
            elif look.time >= due + 1.0 - 1e-6 or (before is not None and _kind(look) != before):
                due, before = look.time, _kind(look)
                say(view.line(look))
            if seconds is not None and look.time >= seconds - 1e-6:
                return
    if watch.recorded:
        say(f"the log ended after {last.time if last else 0.0:.1f} s")


class _View:
    """Looks as text.

    Raises:
        InputError: the robot file has no calibration.
    """

    def __init__(self, robot: Robot) -> None:
        self.names, self.points = Layout.of(robot).actuator_names, Layout.of(robot).point_names
        self.calibration = Calibration.of(robot)

    def values(self, look: MonitorReading) -> tuple[np.ndarray, np.ndarray]:
        """Pressures in kPa and tensions in N of all actuators; NaN without a status."""
        if look.status is None:
            nothing = np.full(len(self.names), np.nan)
            return nothing, nothing
        return self.calibration.pressures(look.status.monitors) / 1e3, self.calibration.tensions(look.status.dynamometers)

    def line(self, look: MonitorReading) -> str:
        """One line."""
        parts = [f"{look.time:7.1f} s", look.words]
        if look.status is not None:
            pressures, tensions = self.values(look)
            parts.append("kPa " + " ".join(f"{name}:{value:.1f}" for name, value in zip(self.names, pressures, strict=True)))
            parts.append("N " + " ".join(f"{name}:{value:.2f}" for name, value in zip(self.names, tensions, strict=True)))
            parts.append("steps " + " ".join(f"{value}" for value in look.status.positions[: len(self.names)]))
        parts += [look.tracker] if look.tracker else []
        return "; ".join([*parts, _line_words(look)])

    def table(self, look: MonitorReading) -> RenderableType:
        """For a terminal."""
        state = None if look.status is None else look.status.state
        style = "green" if state is State.IDLE else "yellow" if state is State.ARMED else "red"
        actuators = Table("actuator", "pressure kPa", "tension N", "motor steps", "motor")
        for column in actuators.columns[1:4]:
            column.justify = "right"
        pressures, tensions = self.values(look)
        for k, name in enumerate(self.names):
            position, on = ("–", "–")
            if look.status is not None:
                position, on = str(look.status.positions[k]), "on" if look.status.enabled >> k & 1 else "off"
            actuators.add_row(name, _number(pressures[k], 1), _number(tensions[k], 3), position, on)
        shown: list[RenderableType] = [Text(f"{look.time:.1f} s  {look.words}", style=f"bold {style}"), actuators]
        if look.tracker:
            points = Table("point", "x mm", "y mm", "z mm", *(() if look.frame is None else (f"age {1e3 * look.frame.age:.0f} ms",)))
            for k, name in enumerate(self.points):
                at = np.full(3, np.nan) if look.frame is None or k >= len(look.frame.points) else 1e3 * look.frame.points[k]
                points.add_row(name, *(_number(value, 1) for value in at))
            shown += [points, Text(look.tracker)]
        return Group(*shown, Text(_line_words(look), style="dim"))


def _kind(look: MonitorReading) -> tuple[object, ...]:
    """What is said at once where it changes and nobody looks at a terminal."""
    return (None,) if look.status is None else (look.status.state, look.status.fault)


def _line_words(look: MonitorReading) -> str:
    return f"{look.rate:.0f} messages a second, {look.lost} lost, {look.bad} damaged"


def _number(value: float, digits: int) -> str:
    return "–" if np.isnan(value) else f"{value + 0.0:.{digits}f}"

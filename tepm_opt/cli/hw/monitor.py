"""`tepm hw monitor`: what board and tracker say, live."""

from __future__ import annotations

import math
import time
from contextlib import nullcontext
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from tepm_opt.cli.common import SOLVED, RobotOption, stdout
from tepm_opt.cli.hw import shared
from tepm_opt.cli.hw.shared import safely, say
from tepm_opt.hw.board.protocol import State

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tepm_opt.hw.service.monitor import Monitor, MonitorReading
    from tepm_opt.models.robot import Robot


def monitor(
    port: Annotated[str, typer.Argument(metavar="PORT", help="Serial port, PORT or PORT@BAUD, or log:FILE to play a link log back.")],
    seconds: Annotated[float | None, typer.Option("--seconds", min=0.1, help="End after so long; without it, with Ctrl-C.")] = None,
    robot: RobotOption = None,
) -> int:
    """Show state, pressures, tensions, motors, tracker and line. Never arms; opens the port again when the cable was out.

    Opening the port restarts the board, so a robot that another program moves cannot be looked at.
    """
    from tepm_opt.hw.service.line import LOG
    from tepm_opt.hw.service.monitor import Monitor
    from tepm_opt.models.robot import load_robot

    found = load_robot(robot or "kang2017")
    view = _View(found)

    def work() -> int:
        tracker = None if port.startswith(LOG) else shared.open_tracker(found)
        watch = None
        try:
            watch = Monitor(lambda: shared.open_line(port), tracker)
            _show(watch, view, seconds)
        finally:
            if watch is not None:
                watch.close()
            if tracker is not None:
                tracker.close()
        return SOLVED

    return safely(work, "the board was not armed", "the board was not armed")


def _show(watch: Monitor, view: _View, seconds: float | None) -> None:
    """Show readings until the time is over or the log ends."""
    from tepm_opt.hw.service.monitor import PERIOD

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
        from tepm_opt.hw.board.calibration import Calibration
        from tepm_opt.models.layout import Layout

        self.names, self.points = Layout.of(robot).actuator_names, Layout.of(robot).point_names
        self.calibration = Calibration.of(robot)

    def values(self, look: MonitorReading) -> tuple[Sequence[float], Sequence[float]]:
        """Pressures in kPa and tensions in N of all actuators; NaN without a status."""
        if look.status is None:
            nothing = [math.nan] * len(self.names)
            return nothing, nothing
        pressures, tensions = self.calibration.pressures(look.status.monitors), self.calibration.tensions(look.status.dynamometers)
        return [float(value) / 1e3 for value in pressures], [float(value) for value in tensions]

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
                at = [math.nan] * 3 if look.frame is None or k >= len(look.frame.points) else look.frame.points[k]
                points.add_row(name, *(_number(1e3 * value, 1) for value in at))
            shown += [points, Text(look.tracker)]
        return Group(*shown, Text(_line_words(look), style="dim"))


def _kind(look: MonitorReading) -> tuple[object, ...]:
    """What is said at once where it changes and nobody looks at a terminal."""
    return (None,) if look.status is None else (look.status.state, look.status.fault)


def _line_words(look: MonitorReading) -> str:
    return f"{look.rate:.0f} messages a second, {look.lost} lost, {look.bad} damaged"


def _number(value: float, digits: int) -> str:
    return "–" if math.isnan(value) else f"{value + 0.0:.{digits}f}"

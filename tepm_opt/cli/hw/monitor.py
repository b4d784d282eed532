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
        readings = None
        try:
            readings = Monitor(lambda: shared.open_line(port), tracker)
            _show(readings, view, seconds)
        finally:
            if readings is not None:
                readings.close()
            if tracker is not None:
                tracker.close()
        return SOLVED

    return safely(work, "the board was not armed", "the board was not armed")


def _show(readings: Monitor, view: _View, seconds: float | None) -> None:
    """Show readings until the time is over or the log ends."""
    from tepm_opt.hw.service.monitor import PERIOD

    terminal, due, last, before = stdout.is_terminal, 0.0, None, None
    with Live(console=stdout, refresh_per_second=10, transient=False) if terminal else nullcontext() as live:
        for reading in readings:
            last = reading
            if live is not None:
                live.update(view.table(reading))
                time.sleep(PERIOD if readings.recorded else 0.0)
            elif reading.time >= due + 1.0 - 1e-6 or (before is not None and _kind(reading) != before):
                due, before = reading.time, _kind(reading)
                say(view.line(reading))
            if seconds is not None and reading.time >= seconds - 1e-6:
                return
    if readings.recorded:
        say(f"the log ended after {last.time if last else 0.0:.1f} s")


class _View:
    """Readings as text.

    Raises:
        InputError: the robot file has no calibration.
    """

    def __init__(self, robot: Robot) -> None:
        from tepm_opt.hw.board.calibration import Calibration
        from tepm_opt.models.layout import Layout

        self.names, self.points = Layout.from_robot(robot).actuator_names, Layout.from_robot(robot).point_names
        self.calibration = Calibration.from_robot(robot)

    def values(self, reading: MonitorReading) -> tuple[Sequence[float], Sequence[float]]:
        """Pressures in kPa and tensions in N of all actuators; NaN without a status, or where there are no monitors."""
        nothing = [math.nan] * len(self.names)
        if reading.status is None:
            return nothing, nothing
        pressures, tensions = self.calibration.pressures(reading.status.monitors), self.calibration.tensions(reading.status.dynamometers)
        return [float(value) / 1e3 for value in pressures] if reading.monitored else nothing, [float(value) for value in tensions]

    def line(self, reading: MonitorReading) -> str:
        """One line."""
        parts = [f"{reading.time:7.1f} s", reading.words]
        if reading.status is not None:
            pressures, tensions = self.values(reading)
            parts.append("kPa " + " ".join(f"{name}:{_number(value, 1)}" for name, value in zip(self.names, pressures, strict=True)))
            parts.append("N " + " ".join(f"{name}:{value:.2f}" for name, value in zip(self.names, tensions, strict=True)))
            parts.append("steps " + " ".join(f"{value}" for value in reading.status.positions[: len(self.names)]))
        parts += [reading.tracker] if reading.tracker else []
        return "; ".join([*parts, _line_words(reading)])

    def table(self, reading: MonitorReading) -> RenderableType:
        """For a terminal."""
        state = None if reading.status is None else reading.status.state
        style = "green" if state is State.IDLE else "yellow" if state is State.ARMED else "red"
        actuators = Table("actuator", "pressure kPa", "tension N", "motor steps", "motor")
        for column in actuators.columns[1:4]:
            column.justify = "right"
        pressures, tensions = self.values(reading)
        for k, name in enumerate(self.names):
            position, on = ("–", "–")
            if reading.status is not None:
                position, on = str(reading.status.positions[k]), "on" if reading.status.enabled >> k & 1 else "off"
            actuators.add_row(name, _number(pressures[k], 1), _number(tensions[k], 3), position, on)
        shown: list[RenderableType] = [Text(f"{reading.time:.1f} s  {reading.words}", style=f"bold {style}"), actuators]
        if reading.tracker:
            points = Table("point", "x mm", "y mm", "z mm", *(() if reading.frame is None else (f"age {1e3 * reading.frame.age:.0f} ms",)))
            for k, name in enumerate(self.points):
                at = [math.nan] * 3 if reading.frame is None or k >= len(reading.frame.points) else reading.frame.points[k]
                points.add_row(name, *(_number(1e3 * value, 1) for value in at))
            shown += [points, Text(reading.tracker)]
        return Group(*shown, Text(_line_words(reading), style="dim"))


def _kind(reading: MonitorReading) -> tuple[object, ...]:
    """Extract the state whose change is printed at once where the output is no terminal."""
    return (None,) if reading.status is None else (reading.status.state, reading.status.fault)


def _line_words(reading: MonitorReading) -> str:
    return f"{reading.rate:.0f} messages a second, {reading.lost} lost, {reading.bad} damaged"


def _number(value: float, digits: int) -> str:
    return "–" if math.isnan(value) else f"{value + 0.0:.{digits}f}"

"""`tepm studio`: the robot in the browser."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Annotated

import typer

from tepm_opt.cli.common import SOLVED, ModelOption, RobotOption, load, open_page, stderr
from tepm_opt.cli.rigs import stopped_by_signals

PortOption = Annotated[int, typer.Option("--port", min=0, max=65535, help="Port on this computer; 0 takes a free one.")]
BrowserOption = Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page, or only tell its address.")]


def studio(
    what: Annotated[
        Path | None,
        typer.Argument(metavar="RECORDING", help="To watch beside its model: a run or log (CSV), a folder of mpc, record or discrepancy."),
    ] = None,
    rig: Annotated[str, typer.Option("--rig", help="Of the closed loop: sim or sim:FILE. A page moves no real robot.")] = "sim",
    port: PortOption = 0,
    browser: BrowserOption = True,
    robot: RobotOption = None,
    model: ModelOption = None,
) -> int:
    """Drag the tip, set inputs, watch recordings and disturb a closed loop, on a page in the browser.

    The page is on this computer only, behind an address that opens once, and asks nothing of any network. Ctrl-C ends it.
    """
    from tepm_opt.models.compile import compile_model
    from tepm_opt.studio.page import Studio
    from tepm_opt.studio.recordings import open_recordings

    if what is None or robot or model:
        compiled = load(robot, model)
        recordings = None if what is None else open_recordings(what, compiled.model)
    else:
        recordings = open_recordings(what)
        compiled = compile_model(next(iter(recordings.models.values())))
    with Studio(compiled, recordings, rig, port) as page, stopped_by_signals():
        try:
            open_page(page.address, browser)
            threading.Event().wait()
        except KeyboardInterrupt:
            stderr.print("closed")
    return SOLVED

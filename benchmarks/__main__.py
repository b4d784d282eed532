"""Command line: `python -m benchmarks --limit FOLDER --reference FOLDER --json FILE --only PART --quick`."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer
from rich.console import Console

from benchmarks import control, control_loop, dynamics, gain, kinematics, statics
from benchmarks.limit import Limit
from benchmarks.report import print_report, write_json
from benchmarks.scene import Scene
from benchmarks.timing import Task, measure
from benchmarks.workshop import Workshop
from tepm_opt.errors import InputError

WIDTH = 160  # of the table


def _pin() -> str:
    """Keep this process and its children on one core where the system allows it."""
    try:
        core = max(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {core})
    except (AttributeError, OSError):
        return "not pinned to a core"
    return f"pinned to core {core}"


def main(
    limit: Annotated[Path | None, typer.Option(envvar="TEPM_LIMIT", help="Folder of time_limit.py, the practical limit.")] = None,
    json: Annotated[Path | None, typer.Option(help="Write all figures to this file, too.")] = None,
    reference: Annotated[Path | None, typer.Option(help="Data set to simulate; made-up runs of 177 s otherwise.")] = None,
    only: Annotated[
        Literal["still", "motion", "control"] | None, typer.Option(help="Only statics, gain and inverse kinematics, motion, or control.")
    ] = None,
    quick: Annotated[bool, typer.Option(help="Fewer repetitions, without the slowest peers.")] = False,
) -> None:
    """Statics, gain, inverse kinematics, motion and control of robot kang2017: ours, peers, the practical limit."""
    progress = Console(stderr=True)
    pinned = _pin()
    rounds = 25 if quick else 100
    with tempfile.TemporaryDirectory() as folder:
        progress.print("compiling ours and the peers …")
        try:
            scene = Scene.of("kang2017")
            workshop = Workshop.at(Path(folder))
        except InputError as error:
            raise typer.BadParameter(str(error)) from error
        practical = Limit(limit, Path(folder))
        tasks: list[Task] = []
        if only in (None, "still"):
            peers = statics.Peers.of(scene, workshop)
            tasks += [
                statics.task("warm", "Statics, warm: +1 kPa in p_11 and p_21", scene, peers, scene.bent, scene.nudged),
                statics.task("cold", "Statics, cold: rest to 0.15 MPa in p_11 and p_21", scene, peers, scene.rest, scene.bent),
                gain.task(scene, peers, workshop),
                *kinematics.tasks(scene, peers, workshop),
            ]
        if only in (None, "motion"):
            try:
                tasks += dynamics.tasks(scene, workshop, reference, quick)
            except InputError as error:
                raise typer.BadParameter(str(error)) from error
        if only in (None, "control"):
            tasks += control.tasks(scene.model, control_loop.recorded_step(scene.model))
        for task in tasks:
            if not quick or task is tasks[0]:
                progress.print("running the limit …")
                practical.run()
            progress.print(f"timing {task.title} …")
            measure(task, rounds if np.isnan(task.simulated) else dynamics.rounds(rounds), quick)
    console = Console(width=max(Console().width, WIDTH))
    print_report(console, tasks, practical, pinned, rounds)
    if only in (None, "control"):
        progress.print("closing the loop …")
        control_loop.keep_pace(scene.model, console, 8.0 if quick else 60.0)
    if json:
        write_json(json, tasks, practical, pinned)


if __name__ == "__main__":
    typer.run(main)

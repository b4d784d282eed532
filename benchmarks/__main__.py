"""Command line: `python -m benchmarks --limit FOLDER --json FILE --quick`."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from benchmarks import gain, kinematics, statics
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
    quick: Annotated[bool, typer.Option(help="Fewer repetitions, without the slowest peers.")] = False,
) -> None:
    """Statics, gain and inverse kinematics of robot kang2017: ours, peers, the practical limit."""
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
        peers = statics.Peers.of(scene, workshop)
        tasks: list[Task] = [
            statics.task("warm", "Statics, warm: +1 kPa in p_11 and p_21", scene, peers, scene.bent, scene.nudged),
            statics.task("cold", "Statics, cold: rest to 0.15 MPa in p_11 and p_21", scene, peers, scene.rest, scene.bent),
            gain.task(scene, peers, workshop),
            *kinematics.tasks(scene, peers, workshop),
        ]
        for task in tasks:
            if not quick or task is tasks[0]:
                progress.print("running the limit …")
                practical.run()
            progress.print(f"timing {task.title} …")
            measure(task, rounds, quick)
    print_report(Console(width=max(Console().width, WIDTH)), tasks, practical, pinned, rounds)
    if json:
        write_json(json, tasks, practical, pinned)


if __name__ == "__main__":
    typer.run(main)

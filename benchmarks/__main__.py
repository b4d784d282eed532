"""Command line: `python -m benchmarks --only PART --quick --limit FOLDER --reference FOLDER --data FOLDER --json FILE --page FILE`."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from benchmarks.cores import pin
from benchmarks.inputs import checked_file, checked_limit, checked_reference, data_sets
from benchmarks.parts import Part, Session, goals, tasks
from tepm_opt.errors import InputError

WIDTH = 160  # of the table


def main(
    limit: Annotated[Path | None, typer.Option(envvar="TEPM_LIMIT", help="Folder of time_limit.py, the practical limit.")] = None,
    json: Annotated[Path | None, typer.Option(help="Write all figures to this file, too.")] = None,
    page: Annotated[Path | None, typer.Option(help="Write a page, too: targets and times.")] = None,
    reference: Annotated[Path | None, typer.Option(help="Data set of kang2017 to simulate; made-up runs of 177 s otherwise.")] = None,
    data: Annotated[Path | None, typer.Option(help="Data set to explain, or a folder of such; one made here otherwise.")] = None,
    only: Annotated[list[Part] | None, typer.Option(help="Only this part; may be given several times.")] = None,
    quick: Annotated[bool, typer.Option(help="Fewer repetitions, without the slowest peers.")] = False,
) -> None:
    """Statics, gain, inverse kinematics, motion, control, the rig and verdicts of robot kang2017: ours, peers, the practical limit."""
    try:
        checked_limit(limit)
        checked_file("--json", json)
        checked_file("--page", page)
        session_data = data_sets(data), checked_reference(reference)
    except InputError as error:
        raise typer.BadParameter(str(error)) from error
    with tempfile.TemporaryDirectory() as folder:
        session = Session(Path(folder), quick, session_data[1], session_data[0])
        try:
            _run(session, list(dict.fromkeys(only or Part)), limit, json, page)
        except InputError as error:
            raise typer.BadParameter(str(error)) from error


def _run(session: Session, parts: list[Part], limit: Path | None, json: Path | None, page: Path | None) -> None:
    """Measure and print."""
    from benchmarks import dynamics
    from benchmarks.limit import Limit
    from benchmarks.page import write_benchmark_page
    from benchmarks.report import figures, print_report, write_json
    from benchmarks.timing import measure

    progress, rounds, pinned = Console(stderr=True), 25 if session.quick else 100, pin()
    practical = Limit(limit, session.scratch)
    found = []
    for part in parts:
        progress.print(f"{part}: compiling ours and the peers …")
        found += tasks(part, session)
    for task in found:
        if not task.once and (not session.quick or task is found[0]):
            progress.print("running the limit …")
            practical.run()
        progress.print(f"timing {task.title} …")
        measure(task, dynamics.rounds(rounds) if task.simulated > 0 else rounds, session.quick)
    measured = figures(goals(parts), found, practical)
    print_report(Console(width=max(Console().width, WIDTH)), measured, found, practical, pinned, rounds)
    if json:
        write_json(json, measured, found, practical, pinned)
    if page:
        write_benchmark_page(page, measured, found, pinned)


if __name__ == "__main__":
    typer.run(main)

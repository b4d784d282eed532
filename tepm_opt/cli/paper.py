"""`tepm paper`: the paper's experiments, published numbers beside ours."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from tepm_opt.cli.common import JsonOption, report, stderr
from tepm_opt.data.files import output_folder
from tepm_opt.paper.study import EXPERIMENTS, chosen, run_study, save_study, seconds


def paper(
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("paper"),
    figure: Annotated[list[str] | None, typer.Option("--figure", help=f"Only this one (repeatable): {', '.join(EXPERIMENTS)}.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="One run each and part of the circle.")] = False,
    rig: Annotated[str, typer.Option("--rig", help="Rig file: a built-in name or a path.")] = "virtual_prototype",
    as_json: JsonOption = False,
) -> int:
    """The paper's Table I and Figs. 6 to 12 on the simulated rig and the model: figures, tables and one HTML page."""
    names = chosen(figure or [])
    folder = output_folder(out)
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=stderr, transient=True, disable=as_json or not stderr.is_terminal) as bar:
        task = bar.add_task("", total=sum(seconds(name, 1 if quick else 3, quick) for name in names))

        def track(items: Iterable[str]) -> Iterator[str]:
            done = 0.0
            for name in items:
                bar.update(task, description=name, completed=done)
                yield name
                done += seconds(name, 1 if quick else 3, quick)

        study = run_study(rig, names, quick, track, lambda passed: bar.advance(task, passed), lambda found: save_study(found, folder))
    save_study(study, folder)
    summary = study.summary()
    return report(summary, _lines(summary, folder), as_json, ok=True)


def _lines(summary: dict, folder: Path) -> list[str]:
    lines = []
    for row in summary["rows"]:
        mark = "[green]within 15 %[/]" if row["within"] else "[yellow]not within 15 %[/]"
        name = escape(f"{row['figure']:>6}  {row['text']}")
        lines.append(f"{name:<60} {row['published']:8.2f} {row['ours']:8.2f} {row['unit']:<6} {mark}")
    lines += [f"[yellow]does not hold:[/] {check['figure']}: {escape(check['text'])}" for check in summary["checks"] if not check["holds"]]
    lines += ["[yellow]interrupted: what was finished is kept[/]"] if summary["interrupted"] else []
    within = f"[bold]{summary['within_15_percent']} of {summary['numbers']}[/] published numbers within 15 %"
    return [*lines, f"{within}; open [bold]{escape(str(folder / 'index.html'))}[/]"]

"""`tepm study paper`: the paper's experiments, published numbers beside ours."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from tepm_opt import studies
from tepm_opt.cli.common import JsonOption, report
from tepm_opt.cli.progress import show_progress
from tepm_opt.data.files import output_folder

if TYPE_CHECKING:
    from tepm_opt.studies import Study


def paper(
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("paper"),
    figure: Annotated[list[str] | None, typer.Option("--figure", help="Only this one (repeatable): table1, fig6 … fig12.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="One run each and part of the circle.")] = False,
    rig: Annotated[str, typer.Option("--rig", help="Rig file: a built-in name or a path.")] = "virtual_prototype",
    as_json: JsonOption = False,
) -> int:
    """The paper's Table I and Figs. 6 to 12 on the simulated rig and the model: figures, tables and one HTML page."""
    from tepm_opt.studies.paper.run import select_experiments

    names = select_experiments(figure or [])
    folder = output_folder(out)
    with show_progress(as_json) as bars:
        study = studies.run_study(rig, names, quick, bars, lambda found: save(found, folder))
    save(study, folder)
    summary = study.summary()
    return report(summary, _lines(summary, folder), as_json, ok=True)


def save(study: Study, folder: Path) -> None:
    """Write what a study found: figures (PNG), the tables behind them (CSV), paper.json and index.html.

    Raises:
        InputError: the folder cannot be written to.
    """
    images = studies.draw_experiments(study, folder)
    study.save(folder)
    studies.write_paper_page(folder / "index.html", study.summary(), study.results, images, study.setting.rig)


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

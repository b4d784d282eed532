"""`tepm discrepancy`: which physical effect is missing from the model?"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from threading import Thread
from typing import Annotated

import typer
from rich.markup import escape

import tepm_opt as tepm
from tepm_opt import plots
from tepm_opt.cli import INTERRUPTED
from tepm_opt.cli.common import SOLVED, UNSOLVED, JsonOption, stdout, warn
from tepm_opt.cli.progress import show_progress

PAGE = "report.html"


def _import_what_comes_last() -> None:
    """Import what draws and what learns without physics."""
    import_module("sklearn.gaussian_process")
    _ = plots.draw


def discrepancy(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="Folder with dataset.toml and a CSV file a run.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("discrepancy"),
    model: Annotated[Path | None, typer.Option("--model", help="Model file instead of the data set's robot as it is.")] = None,
    plant: Annotated[Path | None, typer.Option("--plant", help="Python file of another machine, which the data set is of.")] = None,
    add: Annotated[
        list[Path] | None,
        typer.Option("--add", metavar="DATASET", help="More data of the same machine, such as a run of tepm data next."),
    ] = None,
    baseline: Annotated[
        Path | None,
        typer.Option("--baseline", metavar="OLD", help="Earlier data of the same machine, or its baseline.json: tell what changed since."),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", help="Of all random draws.")] = 0,
    despite_errors: Annotated[bool, typer.Option("--despite-errors", help="Go on where the check of the data finds errors.")] = False,
    invent: Annotated[bool, typer.Option("--invent", help="Seek a law where no known effect explains what is left.")] = False,
    minutes: Annotated[float | None, typer.Option("--minutes", help="End the search after so long and say what is untried.")] = None,
    mend: Annotated[bool, typer.Option("--mend", help="Write the data without their set-up errors into OUT/mended.")] = False,
    as_json: JsonOption = False,
) -> int:
    """Find where model and data disagree, name the missing effect, add it to the model, show the gap shrink.

    Writes verdict.json, model.toml (for --model of every command), report.html and its figures. An interrupted run goes on where it
    was when started again. Exit status: 0 named or nothing missing, 1 set-up error, indistinguishable or unexplained.
    """
    from tepm_opt.discrepancy.reporting.effect_table import effect_table, sentences_beside_table
    from tepm_opt.discrepancy.symbolic.page import paragraph
    from tepm_opt.jobs.discrepancy import EFFECTS, MODEL, VALUES, VERDICT
    from tepm_opt.solvers.numerics.text import align_columns

    try:
        with show_progress(as_json, told=True) as progress:
            Thread(target=_import_what_comes_last, daemon=True).start()  # a second, beside the search
            options = tepm.DiscrepancyOptions(seed, despite_errors, invent, add or (), mend, baseline, minutes)
            result = tepm.run_discrepancy(dataset, out, model, plant, options, progress)
            progress("drawing", 0, 0)
            pictures = plots.draw(result, out)
            if result.law is not None:
                plots.draw(result.law, out / EFFECTS)
            provenance = {
                "data set": f"{result.dataset.name} ({', '.join(map(str, (dataset, *(add or ()))))})",
                "machine": result.verdict.machine,
                "model": str(plant or model or "the robot as it is"),
                **({"baseline": str(baseline)} if baseline else {}),
                "tepm_opt": version("tepm-opt"),
                "seed": str(seed),
            }
            tepm.write_discrepancy_page(
                out / PAGE, result.verdict, result.localisation, pictures, provenance, tepm.discovery_charts(result)
            )
    except KeyboardInterrupt:
        warn(f"interrupted: finished fits are kept in {out}; the same command goes on from there")
        return INTERRUPTED
    verdict, status = result.verdict, tepm.VerdictStatus
    found = verdict.status in (status.NAMED, status.NO_DISCREPANCY)
    if as_json:
        print((out / VERDICT).read_text(encoding="utf-8"), end="")
    else:
        stdout.print(f"[bold {'green' if found else 'yellow'}]{verdict.status.value}[/]")
        head, rows = effect_table(verdict)
        places = result.localisation.sentence
        for line in (
            *verdict.setup_sentences,
            *(align_columns(head, rows) if rows else ()),
            *sentences_beside_table(verdict, places),
            verdict.step,
            *((places,) if places in verdict.sentences else ()),
            *verdict.notes,
            *([paragraph(result.law), f"{result.law.file}"] if result.law is not None else []),
            f"{verdict.seconds:.0f} s, {verdict.fits} fits; {out / PAGE}, {out / (VALUES if plant else MODEL)}, {out / VERDICT}",
        ):
            stdout.print(escape(line), soft_wrap=True, highlight=False)
    return SOLVED if found else UNSOLVED

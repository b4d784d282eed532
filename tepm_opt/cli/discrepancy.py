"""`tepm discrepancy`: which physical effect is missing from the model?"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from matplotlib.figure import Figure
from rich.markup import escape

from tepm_opt import plots
from tepm_opt.cli.common import INTERRUPTED, JsonOption, stderr, stdout
from tepm_opt.data.metrics import point_errors
from tepm_opt.discrepancy.search import Hypothesis
from tepm_opt.discrepancy.verdict import VerdictStatus
from tepm_opt.discrepancy.workflow import Discovery
from tepm_opt.jobs.discrepancy import MODEL, VERDICT, run_discrepancy
from tepm_opt.plots import discrepancy as figures
from tepm_opt.report import write_discrepancy_page

PAGE = "report.html"
COLOUR = {
    VerdictStatus.NAMED: "green",
    VerdictStatus.NO_DISCREPANCY: "green",
    VerdictStatus.INDISTINGUISHABLE: "yellow",
    VerdictStatus.UNEXPLAINED: "yellow",
}


@contextmanager
def told(quiet: bool) -> Iterator[Callable[[str], None]]:
    """Lines of progress on the error stream, with the time since the start; on a terminal the current one spins."""
    began = time.monotonic()
    with stderr.status("reading the data") as status:

        def tell(text: str) -> None:
            if not quiet:
                stderr.print(f"[dim]{time.monotonic() - began:6.1f} s[/]  {escape(text)}", highlight=False)
            status.update(escape(text))

        yield tell


def draw(result: Discovery) -> dict[str, Figure]:
    """Figures by the name that the page gives them."""
    verdict, place = result.verdict, result.localisation
    runs = result.dataset.validation or result.dataset.runs
    data = "validation runs" if result.dataset.validation else "fit runs"
    at = [result.dataset.runs.index(run) for run in runs]
    predictions = {name: [points[k] for k in at] for name, points in result.predictions.items()}
    by_point = {name: _rms_by_point([run.points for run in runs], points) for name, points in predictions.items()}
    errors = {name.replace("_", " "): value for name, value in vars(verdict.errors).items()}
    found = {
        "heat": figures.heat_figure(place.heat, place.runs, place.points),
        "gap": figures.gap_figure(errors, data=data),
        "points": figures.points_figure(place.points, by_point, verdict.errors.noise_floor, data=data),
        "over_time": figures.over_time_figure(runs, predictions, verdict.errors.noise_floor),
        "tip": figures.tip_figure(runs, predictions),
    }
    explanation = result.explanation
    fitted = [h for h in explanation.tried if len(h.effects) == 1] + [explanation.best] * (len(explanation.best.effects) > 1)
    if fitted:
        closes = {_label(h): explanation.closes(h) for h in fitted}
        sure = {_label(explanation.best), *(effect.label for effect in explanation.best.effects)}
        named = {each.candidate.label for each in verdict.effects}
        found["evidence"] = figures.evidence_figure(closes, sure & closes.keys(), (named - sure) & closes.keys())
    return found


def _label(hypothesis: Hypothesis) -> str:
    return " + ".join(effect.label for effect in hypothesis.effects)


def _rms_by_point(measured: list[np.ndarray], modelled: list[np.ndarray]) -> np.ndarray:
    squares = point_errors(np.concatenate(measured), np.concatenate(modelled)) ** 2
    count = np.isfinite(squares).sum(axis=0)
    return np.sqrt(np.where(count, np.nansum(squares, axis=0) / np.maximum(count, 1), np.nan))


def discrepancy(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="Folder with dataset.toml and a CSV file a run.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("discrepancy"),
    model: Annotated[Path | None, typer.Option("--model", help="Model file instead of the data set's robot as it is.")] = None,
    seed: Annotated[int, typer.Option("--seed", help="Of all random draws.")] = 0,
    despite_errors: Annotated[bool, typer.Option("--despite-errors", help="Go on where the check of the data finds errors.")] = False,
    as_json: JsonOption = False,
) -> int:
    """Find where model and data disagree, name the missing effect, add it to the model, show the gap shrink.

    Writes verdict.json, model.toml (for --model of every command), report.html and its figures. An interrupted run goes on where it
    was when started again. Exit status: 0 named or nothing missing, 1 indistinguishable or unexplained.
    """
    try:
        with told(as_json) as tell:
            result = run_discrepancy(dataset, out, model, seed, despite_errors, lambda stage, done, of: tell(stage))
            tell("drawing")
            drawn = draw(result)
            pictures = {name: out / f"{name}.png" for name in drawn}
            for name, figure in drawn.items():
                plots.save(figure, pictures[name])
            provenance = {
                "data set": f"{result.dataset.name} ({dataset})",
                "robot": result.dataset.robot,
                "model": str(model or "the robot as it is"),
                "tepm_opt": version("tepm-opt"),
                "seed": str(seed),
            }
            write_discrepancy_page(out / PAGE, result.verdict, result.localisation, pictures, provenance)
    except KeyboardInterrupt:
        stderr.print(f"interrupted: finished fits are kept in {escape(str(out))}; the same command goes on from there", soft_wrap=True)
        return INTERRUPTED
    verdict = result.verdict
    if as_json:
        print((out / VERDICT).read_text(encoding="utf-8"), end="")
    else:
        stdout.print(f"[bold {COLOUR[verdict.status]}]{verdict.status.value}[/]")
        for line in (verdict.paragraph, *verdict.notes, f"{verdict.seconds:.0f} s; {out / PAGE}, {out / MODEL}, {out / VERDICT}"):
            stdout.print(escape(line), soft_wrap=True, highlight=False)
    return 0 if verdict.status in (VerdictStatus.NAMED, VerdictStatus.NO_DISCREPANCY) else 1

"""Figures over the versions: `python -m benchmarks.history FILE` adds those of `python -m benchmarks --json FILE` to history.csv.

Each version has one figure of a name, the last one measured. docs/results/speed.md and its picture are written anew, also without a FILE.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

ROOT = Path(__file__).parent.parent
HISTORY = Path(__file__).with_name("history.csv")
PAGE, PICTURE = ROOT / "docs" / "results" / "speed.md", ROOT / "docs" / "images" / "speed.png"
START, END = "<!-- figures -->", "<!-- end of figures -->"
HEADER = ("version", "name", "figure")

Figures = dict[str, dict[str, float]]
"""By version, then by name."""


def read_history() -> Figures:
    """What history.csv has."""
    found: Figures = {}
    with HISTORY.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            found.setdefault(row["version"], {})[row["name"]] = float(row["figure"])
    return found


def write_history(figures: Mapping[str, Mapping[str, float]]) -> None:
    """Write history.csv."""
    with HISTORY.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HEADER)
        writer.writerows((version, name, f"{value:.4g}") for version, named in figures.items() for name, value in named.items())


def page_text(figures: Figures) -> str:
    """docs/results/speed.md with a table of the figures."""
    from benchmarks.parts import goals
    from benchmarks.report import text_of

    versions = list(figures)
    lines = [f"| figure | target | {' | '.join(versions)} | |", f"| --- | --- |{' --- |' * (len(versions) + 1)}"]
    for goal in goals():
        values = [figures[version].get(goal.name) for version in versions]
        known = [value for value in values if value is not None]
        if not known:
            continue
        met = "" if values[-1] is None else "met" if goal.met(values[-1]) else "missed"
        cells = ["" if value is None else text_of(value) for value in values]
        target = f"{'at least' if goal.at_least else 'at most'} {goal.bound:g}"
        lines.append(f"| {goal.name} | {target} | {' | '.join(cells)} | {met} |")
    table = "\n".join(lines)
    return re.sub(f"{START}.*{END}", lambda _: f"{START}\n\n{table}\n\n{END}", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)


def draw(figures: Figures) -> None:
    """Write the picture: a row a figure, a mark a version, relative to the target; right of 1 it is met."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter

    from benchmarks.parts import goals

    versions = list(figures)
    rows = [goal for goal in goals() if any(goal.name in figures[version] for version in versions)][::-1]
    picture = Figure(figsize=(9.0, 0.26 * len(rows) + 1.1), dpi=150, layout="constrained")
    FigureCanvasAgg(picture)
    axes = picture.add_subplot()
    axes.axvspan(1e-3, 1, color="0.94", zorder=0)
    axes.axvline(1, color="0.4", linewidth=1, zorder=1)
    axes.grid(axis="y", color="0.88", linewidth=0.6)
    axes.set_axisbelow(True)
    shades = [str(0.75 - 0.75 * (k + 1) / len(versions)) if k + 1 < len(versions) else "C0" for k in range(len(versions))]
    for height, goal in enumerate(rows):
        margins = [(k, goal.margin(figures[v][goal.name])) for k, v in enumerate(versions) if goal.name in figures[v]]
        axes.plot([m for _, m in margins], [height] * len(margins), color="0.7", linewidth=1, zorder=2)
        for k, margin in margins:
            axes.plot(margin, height, "o", color=shades[k], markersize=6, zorder=3 + k)
    for k, version in enumerate(versions):
        axes.plot([], [], "o", color=shades[k], label=version)
    shown = [goal.margin(figures[v][goal.name]) for goal in rows for v in versions if goal.name in figures[v]]
    axes.set_xscale("log")
    axes.set_xlim(min(*shown, 0.5) / 1.3, max(*shown, 2) * 1.3)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set_yticks(range(len(rows)), [goal.name for goal in rows], fontsize=7)
    axes.set_ylim(-0.7, len(rows) - 0.3)
    axes.set_xlabel("figure over target; where less is better, target over figure", fontsize=9)
    axes.legend(loc="upper left", fontsize=8)
    picture.savefig(PICTURE)


def main(
    measured: Annotated[Path | None, typer.Argument(help="What `python -m benchmarks --json FILE` wrote.")] = None,
    version: Annotated[str | None, typer.Option(help="Of the package; the first one in CHANGELOG.md otherwise.")] = None,
) -> None:
    """Add figures to the history and write its page."""
    figures = read_history()
    if measured is not None:
        try:
            content = json.loads(measured.read_text(encoding="utf-8"))
            new = {each["name"]: each["measured"] for each in content["targets"] if each["measured"] is not None}
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise typer.BadParameter(f"{measured}: not what `python -m benchmarks --json` writes: {error}") from error
        changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
        name = version or re.findall(r"^## (\d\S*)", changelog, re.MULTILINE)[0]
        figures.setdefault(name, {}).update(new)
        write_history(figures)
        figures = read_history()  # as the file has them: rounded
    PAGE.write_text(page_text(figures), encoding="utf-8")
    draw(figures)


if __name__ == "__main__":
    typer.run(main)

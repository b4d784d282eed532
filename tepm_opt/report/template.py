"""Shared parts of all pages: template, table of figures, pictures, form of numbers. A page is one file and loads nothing."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jinja2

from tepm_opt.data.files import write_atomically
from tepm_opt.discrepancy.assessment.result import Value
from tepm_opt.plots.figure import STYLE
from tepm_opt.report.charts import Chart
from tepm_opt.solvers.numerics.text import format_quantity, percent, with_deviation

CSS_PIXELS = 96  # an inch of a page
NONE = ("", "1", "-")  # units of pure numbers


@dataclass(frozen=True)
class Row:
    """A row of the table of figures.

    Attributes:
        name: what it is.
        unit: of all its values; empty where they have none.
        cells: values as text, one a column.
    """

    name: str
    unit: str
    cells: Sequence[str]


@dataclass(frozen=True)
class Group:
    """Rows of the table of figures with the same columns.

    Attributes:
        title: above the rows.
        columns: their names.
        rows: in order.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Row]


@dataclass(frozen=True)
class Picture:
    """A PNG file as HTML takes it.

    Attributes:
        content: base64.
        width: in CSS px, at which its letters are as large as they were drawn.
    """

    content: str
    width: int

    @classmethod
    def from_figure(cls, figure: Path | bytes) -> Picture:
        """Embed a PNG figure, given as its file or its content."""
        content = figure if isinstance(figure, bytes) else figure.read_bytes()
        pixels = int.from_bytes(content[16:20], "big")  # IHDR, which is the first chunk
        return cls(base64.b64encode(content).decode(), round(pixels * CSS_PIXELS / float(STYLE["dpi"])))  # type: ignore[arg-type]


def write(
    path: str | Path,
    template: str,
    figures: Mapping[str, Path | bytes] | None = None,
    charts: Mapping[str, Chart] | None = None,
    **values: Any,
) -> None:
    """Write a page.

    Args:
        path: of the page.
        template: its name among the package's templates.
        figures: PNG files or their content by the names that the template gives them.
        charts: what scripts draw in the place of figures of the same names.
        values: what the template asks for besides.

    Raises:
        InputError: the folder cannot be written to.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("tepm_opt"), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"sized": format_quantity, "percent": percent, "spread": _spread, "size": _size, "with_unit": with_unit}
    drawn = charts or {}
    images = {name: Picture.from_figure(figure) for name, figure in (figures or {}).items() if name not in drawn}
    page = environment.get_template(template).render(images=images, charts=drawn, version=version("tepm-opt"), **values)
    write_atomically(path, page)


def with_unit(text: str, unit: str) -> str:
    """A number with its unit, alone where it has none."""
    return text if unit in NONE else f"{text} {symbol(unit)}"


def symbol(unit: str) -> str:
    """A unit as tables have it: powers raised, 1 of pure numbers."""
    return "1" if unit in NONE else unit.replace("^2", "²").replace("^3", "³")


def _size(value: Value) -> str:
    """Value and standard deviation of an effect's parameter, and whether that differs from null."""
    null = "0" if value.nominal == 0 else with_unit(f"{value.nominal:.4g}", value.unit)
    return _spread(value) + ("" if value.clear else f" (not significantly different from {null})")


def _spread(value: Value) -> str:
    """Value and standard deviation, to two digits of the latter, with the unit."""
    return with_unit(with_deviation(value.value, value.std), value.unit)

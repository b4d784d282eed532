"""Self-contained HTML pages: about the main job, and about what a model misses."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

import jinja2
import numpy as np

from tepm_opt.data.files import write_atomically
from tepm_opt.discrepancy.localise import Localisation
from tepm_opt.discrepancy.verdict import Value, Verdict, VerdictStatus
from tepm_opt.jobs.demo import DemoRun

HEADINGS = {
    VerdictStatus.NAMED: "The missing effect is named",
    VerdictStatus.NO_DISCREPANCY: "No discrepancy",
    VerdictStatus.INDISTINGUISHABLE: "Several effects explain the data equally well",
    VerdictStatus.PARTIAL: "A known effect explains a part",
    VerdictStatus.UNEXPLAINED: "Not explained by any known effect",
}
RIVALS = 15  # listed on the page


def write_page(path: str | Path, run: DemoRun, figures: Mapping[str, Path]) -> None:
    """Write the page of the main job.

    Args:
        path: of the page.
        run: with all its parts.
        figures: PNG files by name, put into the page: "ik", "gain" and, with loops, "path", "distance", "inputs".

    Raises:
        InputError: the folder cannot be written to.
        ValueError: the run was interrupted before its last part.
    """
    if run.hybrid is None or run.gains is None:
        raise ValueError(f"no page of {run!r}")
    page = (
        environment()
        .get_template("demo.html")
        .render(
            robot=run.pressure.model.robot,
            values=run.pressure.model.values,
            hybrid=run.hybrid.summary(),
            pressure=run.pressure.summary(),
            images=_images(figures),
            spans={kind: [1e3 * low, 1e3 * high] for kind, (low, high) in run.gains.spans().items()},
            loops={name: loop.summary(timing=False) for name, loop in run.loops.items()},
            note=run.note,
            version=version("tepm-opt"),
        )
    )
    write_atomically(path, page)


def write_discrepancy_page(
    path: str | Path, verdict: Verdict, localisation: Localisation, figures: Mapping[str, Path | bytes], provenance: Mapping[str, str]
) -> None:
    """Write the page of a verdict.

    Args:
        path: of the page.
        verdict: the answer.
        localisation: where the nominal model misses.
        figures: PNG files or their content by name, those that there are of "heat", "gap", "points", "over_time", "evidence", "tip".
        provenance: what was used, by what it is: data set, robot, versions, seed.

    Raises:
        InputError: the folder cannot be written to.
    """
    page = (
        environment()
        .get_template("discrepancy.html")
        .render(
            verdict=verdict,
            status=verdict.status.value,
            heading=HEADINGS[verdict.status],
            localisation=localisation,
            places=localisation.places[: localisation.telling],
            rivals=verdict.rivals[:RIVALS],
            images=_images(figures),
            provenance=provenance,
            version=version("tepm-opt"),
        )
    )
    write_atomically(path, page)


def environment() -> jinja2.Environment:
    """Templates of all pages, with their filters."""
    environment = jinja2.Environment(loader=jinja2.PackageLoader("tepm_opt"), autoescape=True, undefined=jinja2.StrictUndefined)
    environment.filters |= {"mm": _mm, "sized": _sized, "percent": _percent, "spread": _spread, "size": _size}
    return environment


def _images(figures: Mapping[str, Path | bytes]) -> dict[str, str]:
    """Contents of PNG files as HTML takes them."""
    contents = {name: figure if isinstance(figure, bytes) else figure.read_bytes() for name, figure in figures.items()}
    return {name: base64.b64encode(content).decode() for name, content in contents.items()}


def _sized(value: float, unit: str) -> str:
    """A value with three digits, lengths in mm; a dash where there is none."""
    if unit == "m":
        return _mm(value)
    return f"{value:#.3g}".rstrip(".") + f" {unit}" if np.isfinite(value) else "–"


def _mm(metres: float) -> str:
    """A length in mm with three digits; a dash where there is none."""
    return f"{1e3 * metres:#.3g}".rstrip(".") + " mm" if np.isfinite(metres) else "–"


def _percent(part: float | None) -> str:
    """A part of one in percent; what is nearly all or nothing is not rounded to it."""
    if part is None or not np.isfinite(part):
        return "–"
    if 0 < part < 0.01 or 0.99 < part < 1:
        return "< 1 %" if part < 0.5 else "> 99 %"
    return f"{100 * part:.0f} %"


def _size(value: Value) -> str:
    """Value and standard deviation of an effect's parameter, and whether that differs from null."""
    null = "0" if value.nominal == 0 else f"{value.nominal:.4g}{f' {value.unit}' if value.unit not in ('', '1') else ''}"
    return _spread(value) + ("" if value.clear else f" (not significantly different from {null})")


def _spread(value: Value) -> str:
    """Value and standard deviation, to two digits of the latter, with the unit."""
    unit = f" {value.unit}" if value.unit not in ("", "1") else ""
    if not np.isfinite(value.std) or value.std <= 0:
        return f"{value.value:.6g}{unit}"
    digits = max(2, min(9, 2 + int(np.floor(np.log10(max(abs(value.value) / value.std, 1.0))))))
    return f"{value.value:.{digits}g} ± {value.std:.2g}{unit}"

"""The page of a verdict: what a model misses, and what explains it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from tepm_opt.discrepancy.assessment.residual_locations import Localisation
from tepm_opt.discrepancy.assessment.result import Errors, Verdict, VerdictStatus
from tepm_opt.discrepancy.reporting.effect_table import effect_table, sentences_beside_table
from tepm_opt.report.charts import Chart
from tepm_opt.report.template import Group, Row, write
from tepm_opt.solvers.numerics.text import digits, percent

HEADINGS = {
    VerdictStatus.NAMED: "The missing effect is named",
    VerdictStatus.NO_DISCREPANCY: "No discrepancy",
    VerdictStatus.INDISTINGUISHABLE: "Several effects explain the data equally well",
    VerdictStatus.PARTIAL: "A known effect explains a part",
    VerdictStatus.SETUP_ERROR: "The set-up has an error",
    VerdictStatus.UNEXPLAINED: "Not explained by any known effect",
}
SEVERAL = {VerdictStatus.NAMED: "The missing effects are named", VerdictStatus.PARTIAL: "Known effects explain a part"}
MODELS = {
    "nominal": "nominal",
    "recalibrated": "recalibrated",
    "corrected": "corrected",
    "black_box": "black box",
    "noise_floor": "noise floor",
}
RIVALS = 15  # listed on the page


def write_discrepancy_page(
    path: str | Path,
    verdict: Verdict,
    localisation: Localisation,
    figures: Mapping[str, Path | bytes],
    provenance: Mapping[str, str],
    charts: Mapping[str, Chart] | None = None,
) -> None:
    """Write the page of a verdict.

    Args:
        path: of the page.
        verdict: the answer.
        localisation: where the nominal model misses.
        figures: PNG files or their content by name, those that there are of "heat", "gap", "points", "over_time", "evidence", "tip".
        provenance: what was used, by what it is: data set, robot, versions, seed.
        charts: what the page draws itself in the place of figures of these names, as `discovery_charts` makes them.

    Raises:
        InputError: the folder cannot be written to.
    """
    head, rows = effect_table(verdict)
    write(
        path, "discrepancy.html", figures, charts,
        verdict=verdict,
        head=head,
        rows=rows,
        sentences=sentences_beside_table(verdict, localisation.sentence),
        groups=[_errors(verdict)],
        status=verdict.status.value,
        heading=summarise_verdict(verdict.status, len(verdict.effects)),
        localisation=localisation,
        places=localisation.places[: localisation.telling],
        rivals=verdict.rivals[:RIVALS],
        provenance=provenance,
    )  # fmt: skip


def summarise_verdict(status: VerdictStatus, effects: int) -> str:
    """Sum a verdict up in a line.

    Args:
        status: kind of answer.
        effects: how many it names.
    """
    several = effects > 1 and status in (VerdictStatus.NAMED, VerdictStatus.PARTIAL)
    return SEVERAL[status] if several else HEADINGS[status]


def error_rows(errors: Mapping[str, float], unit: str) -> Sequence[Row]:
    """A row for the error of each model, by the names of a verdict."""
    factor, shown = (1e3, "mm") if unit == "m" else (1.0, unit)
    return [Row(text, shown, [digits(errors[name], factor)]) for name, text in MODELS.items()]


def _errors(verdict: Verdict) -> Group:
    """Errors of the models, and how much of the gap is closed."""
    errors: Errors = verdict.errors
    gap = errors.nominal > errors.noise_floor and verdict.status is not VerdictStatus.NO_DISCREPANCY
    closed = Row("gap closed", "%", [percent(errors.gap_closed_fraction).removesuffix(" %") if gap else "no gap"])
    name = "RMS of Eq. (5)" if verdict.unit == "m" else "RMS"
    return Group(f"{name}, validation runs", ["error"], [*error_rows(vars(errors), verdict.unit), closed])

"""The page of a model update: effects found, how the gap shrank, how tracking improved."""

from __future__ import annotations

from pathlib import Path

from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.jobs.model_update import ModelUpdate
from tepm_opt.report.discrepancy import error_rows, summarise_verdict
from tepm_opt.report.template import Group, Row, write
from tepm_opt.solvers.numerics.text import digits


def write_model_update_page(path: str | Path, done: ModelUpdate) -> None:
    """Write the page of a model update.

    Args:
        path: of the page.
        done: with all its parts.

    Raises:
        InputError: the folder cannot be written to.
    """
    last, summary = done.verdicts[-1], done.summary()
    tracking = [
        Row(name, "mm", [digits(value, 1e3) if value is not None else "nothing seen" for value in errors.values()])
        for name, errors in summary["tip_error_m"].items()
    ]
    groups = [
        Group("Tip error on a path, rms", ["nominal model", "corrected model"], tracking),
        Group("Error on runs that were not used, rms", ["error"], error_rows(summary["rmse_m"], "m")),
    ]
    status = VerdictStatus(last["status"])
    write(
        path, "close.html",
        summary=summary,
        groups=groups,
        status=status.value,
        heading=summarise_verdict(status, len(last["effects"])),
        table=last.get("table", ()),
        answer=last.get("answer", last["paragraph"]),
    )  # fmt: skip

"""The page of a loop that was closed: what was found, how the gap shrank, how tracking improved."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

from tepm_opt.data.files import write_atomically
from tepm_opt.discrepancy.verdict import VerdictStatus
from tepm_opt.jobs.close import Closing
from tepm_opt.report.pages import HEADINGS, environment

ROWS = {
    "nominal": "as it was",
    "recalibrated": "recalibrated",
    "corrected": "corrected",
    "black_box": "black box without physics",
    "noise_floor": "noise alone",
}


def write_closing_page(path: str | Path, done: Closing) -> None:
    """Write the page.

    Args:
        path: of the page.
        done: with all its parts.

    Raises:
        InputError: the folder cannot be written to.
    """
    last = done.verdicts[-1]
    page = (
        environment()
        .get_template("close.html")
        .render(
            summary=done.summary(),
            heading=HEADINGS[VerdictStatus(last["status"])],
            paragraph=last["paragraph"],
            rows=list(ROWS.items()),
            version=version("tepm-opt"),
        )
    )
    write_atomically(path, page)

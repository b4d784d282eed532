"""The page of the paper's experiments: every published number beside ours, every figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tepm_opt.hw.simulation.rigfile import RigFile
from tepm_opt.report.template import write
from tepm_opt.studies.paper.result import ExperimentResult


def sizes(rig: RigFile) -> list[tuple[str, str]]:
    """List differences of the rig from its model, as text."""
    found = [(f"true {name} over nominal", f"{factor:g}") for name, factor in rig.parameter_factors.items()]
    for name, imperfection in rig.imperfections.active.items():
        plain = type(imperfection)().model_dump()
        found += [(f"{name}: {key}", _text(value)) for key, value in imperfection.model_dump().items() if value != plain[key]]
    return found


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key}: {_text(part)}" for key, part in value.items())
    return f"{value:g}" if isinstance(value, float) else str(value)


def write_paper_page(
    path: Path, summary: Mapping[str, Any], results: Sequence[ExperimentResult], figures: Mapping[str, Path], rig: RigFile
) -> None:
    """Write the page of the paper's experiments.

    Args:
        path: the HTML file.
        summary: numbers of the study, plain data.
        results: of the finished experiments.
        figures: PNG files by the results' names; their content is put into the page.
        rig: the simulated rig that was used.

    Raises:
        InputError: the folder cannot be written to.
    """
    failed = [check for check in summary["checks"] if not check["holds"]]
    write(path, "paper.html", figures, summary=summary, results=results, sizes=sizes(rig), failed=failed)

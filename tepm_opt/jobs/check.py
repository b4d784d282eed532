"""The check of a data set: is it what it says?"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.checks.findings import Finding
from tepm_opt.data.frames import Tabular
from tepm_opt.models.channels import check
from tepm_opt.outcome import Ending, Outcome


class Checked:
    """A data set that was looked at.

    Attributes:
        findings: errors and warnings.
    """

    findings: tuple[Finding, ...]

    @property
    def errors(self) -> int:
        """Number of findings by which a fit to the data would be misled."""
        return sum(finding.severity == "error" for finding in self.findings)

    @property
    def warnings(self) -> int:
        """Number of the other findings."""
        return len(self.findings) - self.errors

    @property
    def outcome(self) -> Outcome:
        """Solved where there is no error."""
        return Outcome(Ending.FAILED, f"{self.errors} errors") if self.errors else Outcome()

    @property
    def ok(self) -> bool:
        """Whether the data can be used."""
        return self.outcome.solved


@dataclass(frozen=True)
class CheckRun(Checked, Tabular):
    """What a check of a data set finds.

    Attributes:
        folder: of the data set.
        findings: errors and warnings.
    """

    folder: Path
    findings: tuple[Finding, ...]

    def __repr__(self) -> str:
        return f"<CheckRun {self.outcome}; {self.folder}, {self.warnings} warnings>"

    def columns(self) -> dict[str, np.ndarray]:
        """The fields of `Finding`, a row a finding."""
        return {f.name: np.array([getattr(finding, f.name) for finding in self.findings]) for f in fields(Finding)}

    def summary(self) -> dict[str, Any]:
        """Numbers and all findings."""
        counts = {"errors": self.errors, "warnings": self.warnings}
        return {"dataset": str(self.folder), **counts, "findings": [asdict(finding) for finding in self.findings]}


def run_check(dataset: str | Path) -> CheckRun:
    """Check a data set for wrong units, broken time, frozen, saturated and interchanged sensors, dropouts, spikes, starts not at rest.

    Args:
        dataset: folder with dataset.toml and a CSV file a run.

    Raises:
        InputError: not readable at all.
    """
    return CheckRun(Path(dataset), tuple(check(dataset)))

"""The check of a data set: is it what it says?"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.checks.dataset import check_reading
from tepm_opt.data.checks.findings import Finding, Severity
from tepm_opt.data.datasets import DESCRIPTION, DataSet
from tepm_opt.data.frames import Tabular
from tepm_opt.data.noise import noise_of
from tepm_opt.discrepancy.adapters.network import SearchableNetwork
from tepm_opt.discrepancy.setup.check import find_setup_errors
from tepm_opt.errors import InputError
from tepm_opt.models.channels import channels_of, read
from tepm_opt.models.model import Model
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.progress import Progress, silent


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
    """Findings of a check of a data set.

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


def run_check(dataset: str | Path, progress: Progress = silent) -> CheckRun:
    """Check a data set for wrong units, broken time, frozen, saturated and interchanged sensors, dropouts, spikes, starts not at rest.

    Data without such errors are also held against simulations with its robot file, which shows mistakes of wiring, axes and units.

    Args:
        dataset: folder with dataset.toml and a CSV file a run.
        progress: told of the simulations.

    Raises:
        InputError: not readable at all.
    """
    reading = read(dataset)
    findings = check_reading(reading)
    if all(finding.is_setup for finding in findings if finding.severity == "error"):
        findings += _setup_findings(reading.usable, progress)
    return CheckRun(Path(dataset), tuple(findings))


def _setup_findings(dataset: DataSet, progress: Progress) -> list[Finding]:
    """Set-up errors that simulations show; the likeliest mend of each is an error, alternatives to it are warnings."""
    known = Model.from_robot(dataset.robot)
    channels = channels_of(known.robot)
    if channels.columns != dataset.channels.columns:
        return []
    try:
        noise = noise_of(dataset)
    except InputError as error:
        return [Finding("warning", DESCRIPTION, None, None, "", f"{error}; until then wiring, axes and units are not checked")]
    progress("compiling the model", 0, 0)
    plant = SearchableNetwork.of_known(known, channels, dataset.static)
    found, _ = find_setup_errors(plant, dataset.runs, noise, progress)
    severities: list[Severity] = ["error" if each.is_mended else "warning" for each in found]
    rows = [(DESCRIPTION, None, None, " ".join(each.channels), each.sentence, True) for each in found]
    return [Finding(severity, *row) for severity, row in zip(severities, rows, strict=True)]

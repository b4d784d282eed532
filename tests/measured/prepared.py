"""Data sets of measured machines, written by the examples' command."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.paths import SHARED

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def prepared(machine: str, folder: Path) -> Path:
    """The folder, in which the data set of a machine now is; the test is skipped where the measurements are not on this machine."""
    if not (SHARED / "real").is_dir() or not (SHARED / "benchmarks").is_dir():
        pytest.skip(f"measurements of {SHARED} are not on this machine")
    subprocess.run([sys.executable, EXAMPLES / "measured.py", machine, SHARED, folder], check=True, timeout=300)
    return folder

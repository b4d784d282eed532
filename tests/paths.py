"""Where the reference data lie: beside the repository, so that they may be absent."""

from __future__ import annotations

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared"


def reference(name: str) -> Path:
    """A file of `../shared/reference`; the test is skipped where it is not there."""
    path = SHARED / "reference" / name
    if not path.exists():
        pytest.skip(f"reference data of {SHARED} are not on this machine")
    return path

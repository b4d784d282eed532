"""What keeps the house in order: style, types, import contracts, small files. Tools that are not installed are skipped with a reason."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
LINES = 400


def run(tool: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A tool of this environment, run on the project."""
    path = shutil.which(tool, path=str(Path(sys.executable).parent))
    if path is None:
        pytest.skip(f"{tool} is not installed (extra dev)")
    return subprocess.run([path, *arguments], cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("arguments", [("check",), ("format", "--check")])
def test_style(arguments: tuple[str, ...]) -> None:
    done = run("ruff", *arguments)
    assert done.returncode == 0, done.stdout + done.stderr


def test_import_contracts() -> None:
    done = run("lint-imports")
    assert "2 kept, 0 broken" in done.stdout, done.stdout + done.stderr


def test_types() -> None:
    done = run("pyright", "--pythonpath", sys.executable)
    if not re.search(r"\d+ errors?, ", done.stdout):
        pytest.skip(f"pyright cannot start here: {(done.stdout + done.stderr).strip()[-200:]}")
    assert done.stdout.startswith("0 errors") or "\n0 errors" in done.stdout, done.stdout


def test_files_fit_a_few_screens() -> None:
    lengths = {path.name: path.read_text(encoding="utf-8").count("\n") for path in (ROOT / "tepm_opt").rglob("*.py")}
    assert not {name: length for name, length in lengths.items() if length > LINES}

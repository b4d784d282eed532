"""What keeps the house in order: style, types, import contracts, small files. Tools that are not installed are skipped with a reason."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in sorted((ROOT / "tepm_opt").rglob("*.py"))}
LINES, BYTES = 400, 22_000
"""Of a file. The second keeps the first from being met by long lines."""


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
    kept = re.search(r"Contracts: (\d+) kept, (\d+) broken", done.stdout)
    assert kept, done.stdout + done.stderr
    declared = (ROOT / "pyproject.toml").read_text(encoding="utf-8").count("[[tool.importlinter.contracts]]")
    assert (int(kept[1]), int(kept[2])) == (declared, 0), done.stdout + done.stderr


@pytest.mark.slow
def test_types() -> None:
    done = run("pyright", "--pythonpath", sys.executable)
    if not re.search(r"\d+ errors?, ", done.stdout):
        pytest.skip(f"pyright cannot start here: {(done.stdout + done.stderr).strip()[-200:]}")
    assert done.stdout.startswith("0 errors") or "\n0 errors" in done.stdout, done.stdout


def test_files_fit_a_few_screens() -> None:
    assert len(PACKAGE) > 150
    assert not {path: text.count("\n") for path, text in PACKAGE.items() if text.count("\n") > LINES}
    assert not {path: len(text) for path, text in PACKAGE.items() if len(text) > BYTES}

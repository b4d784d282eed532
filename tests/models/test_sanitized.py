"""The backends' C under the address and the undefined behaviour sanitizer, over what the tests of the solvers do with it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tepm_opt.models.backends import compiler

ROOT = Path(__file__).resolve().parents[2]
CALLS = (
    "tests/solvers/test_statics.py",
    "tests/solvers/test_gain.py",
    "tests/models/test_backends.py",
    "tests/models/test_time_stepping.py",
)
"""What calls every function of the libraries, on few robots: a library takes some ten seconds to compile with the sanitizers."""


def runtimes() -> list[str]:
    """The sanitizers' libraries, which a process without them has to load first.

    Skips the test where there are none.
    """
    command = compiler.find_compiler()
    if command is None or not sys.platform.startswith("linux"):
        pytest.skip("no C compiler, or no Linux")
    asked = [[*command, f"-print-file-name=lib{name}.so"] for name in ("asan", "ubsan")]
    found = [subprocess.run(each, capture_output=True, text=True, check=False).stdout.strip() for each in asked]
    if not all(Path(path).is_absolute() and Path(path).exists() for path in found):
        pytest.skip(f"{command[0]} has no libasan.so or libubsan.so")
    return found


@pytest.mark.slow
def test_solvers_leave_no_trace_in_the_sanitizers(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    cache.mkdir(mode=0o700)
    environment = os.environ | {
        "LD_PRELOAD": " ".join(runtimes()),
        "ASAN_OPTIONS": "detect_leaks=0",  # Python's own
        "TEPM_OPT_CACHE": str(cache),
        "OPENBLAS_NUM_THREADS": "1",
    }
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-s", "-p", "tests.sanitized", "-p", "no:cacheprovider", *CALLS]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-8000:]
    libraries = [path.read_bytes() for path in cache.rglob("*.so")]
    assert len(libraries) >= 2
    assert all(b"__asan_report" in library and b"__ubsan_handle" in library for library in libraries)

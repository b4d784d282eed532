"""Makes a spoiling in a copy of the project and runs the tests there until one fails."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import CodeType

from tests.hw.spoil import first
from tests.hw.spoil.equivalent import EQUIVALENT
from tests.hw.spoil.operators import shuffled
from tests.hw.spoil.spoiling import DRAWS, FIRMWARE, ROOT, Spoiling, source
from tests.hw.spoil.table import Outcome, caught_last_time

SEED = 2017
LIMIT = 1200.0
"""Seconds after which tests that still run count as hung: all of them take some minutes where many run at the same time."""
COPIED = ("tepm_opt", "tests", "docs", "README.md", "pyproject.toml")
FIRST = {
    "frames.cpp": ("test_frames", "test_faults"),
    "memory.cpp": ("test_sessions",),
    "motors.cpp": ("test_pins", "test_faults", "test_firmware"),
    "board.cpp": ("test_pins", "test_measured", "test_faults", "test_sessions", "test_firmware"),
    "protocol.py": ("test_frames", "test_serial_rig"),
    ".cpp": ("test_faults", "test_firmware", "test_pins"),
    ".h": ("test_faults", "test_firmware"),
    "guard.py": ("test_guard",),
    "commands.py": ("test_serial_rig", "test_simulated"),
    ".py": ("test_host_guards", "test_opening", "test_serial_rig"),
}
"""Test files that notice most of what is wrong in a file, by the end of its name."""
LEFT_OUT = ("test_spoiling", "test_loop")
"""Test files that catch nothing: this one's own, and one that runs in real time, which fails now and then on a machine that is busy."""
NOTHING = Spoiling(f"{FIRMWARE}/board.cpp", "nothing", 0, 0, "")
"""No change at all: has to survive, or catches prove nothing."""


def files_for(file: str) -> list[str]:
    """Test files in the order in which they run for a spoilt file: all that have to do with the board, those that notice most first."""
    folder = ROOT / "tests" / "hw"
    first = next(names for end, names in FIRST.items() if file.endswith(end))
    every = sorted(path for path in folder.glob("test_*.py") if path.stem not in LEFT_OUT)
    about = [
        path
        for path in every
        if re.search(r"hw\.(board|guard|emulator|lines|conftest)|hw import emulator", path.read_text(encoding="utf-8"))
    ]
    return [f"tests/hw/{name}.py" for name in (*first, *(path.stem for path in about if path.stem not in first))]


def try_out(spoiling: Spoiling, folder: Path, tests: list[str] | None = None, limit: float = LIMIT) -> Outcome:
    """Run the tests on a spoilt copy until the first one fails, beginning with the one that caught it the last time.

    Slow tests run, studies do not: those of the episodes spoil the firmware themselves, and fail on any other slip in the same line.

    Args:
        spoiling: what is wrong in the copy.
        folder: for the copy and what the tests write; it is made and removed.
        tests: what to run instead of `files_for` the file.
        limit: seconds after which the tests count as hung.

    Raises:
        RuntimeError: the tests cannot be run at all.
    """
    begin = time.monotonic()
    copy = _copy(folder)
    for each in sorted((spoiling, *spoiling.also), key=lambda change: -change.start):  # those behind first: the places of the others stay
        (copy / each.file).write_text(each.spoil(source(each.file, copy)), encoding="utf-8")
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-x",
        "-m",
        "not study",
        "-q",
        "-rfE",
        "--tb=no",
        "-p",
        "no:cacheprovider",
        "-p",
        first.__name__,
        f"--basetemp={folder / 'pytest'}",
    ]
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST", "COV_"))}
    environment |= {"PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1", "COLUMNS": "300"}
    environment |= {first.VARIABLE: ",".join(f"tests/hw/{test}" for test in caught_last_time(spoiling))}
    environment |= {"TMPDIR": str(folder), "XDG_STATE_HOME": str(folder / "state")}
    process = subprocess.Popen(
        [*command, *(tests or files_for(spoiling.file))],
        cwd=copy,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        said = process.communicate(timeout=limit)[0]
        caught = _caught(process.returncode, said)
    except subprocess.TimeoutExpired:
        caught = "time-out"
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        shutil.rmtree(folder)
    return Outcome(caught, time.monotonic() - begin)


def _copy(folder: Path) -> Path:
    """The project as it is now, without what earlier runs left in it."""
    copy = folder / "project"
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__", "build"))
        else:
            shutil.copy2(ROOT / name, copy / name)
    return copy


def _caught(code: int, said: str) -> str | None:
    """The first test that failed, by what pytest said, or what else went wrong."""
    if code <= 0:
        return "crash" if code else None
    found = re.search(r"^(?:FAILED|ERROR) ([\w/.-]+(?:::\w+)*)", said, re.M)
    if re.search(r"^ERROR .* - RuntimeError: \S+\.(?:cpp|h|o|elf)\b", said, re.M):
        return "compiler"
    if "ImportError while loading conftest" in said:
        return "conftest.py"
    if found is None:
        raise RuntimeError(f"the tests cannot be run (pytest ended with {code}):\n{said[-2000:]}")
    return found[1].removeprefix("tests/hw/")


class Drawing:
    """Draws from one file: each of its draws takes the first of its own share of all slips that makes another program.

    Args:
        file: path below the project's folder.
        folder: firmware is built in it.
        seed: of the order of the slips.

    Attributes:
        left_out: slips that were drawn and not taken, by reason.
    """

    def __init__(self, file: str, folder: Path, seed: int = SEED) -> None:
        self.file, self.text, self.folder = file, source(file), folder
        self.slips = shuffled(file, self.text, seed)
        self.left_out: list[tuple[Spoiling, str]] = []
        self._build: Callable[[str], object] = code_of if file.endswith(".py") else Firmware(file, folder).build
        self._plain = self._build(self.text)

    def draw(self, number: int, of: int | None = None) -> Spoiling:
        """The draw with a number from 0, of so many from this file (as many as DRAWS says)."""
        for slip in self.slips[number :: of or DRAWS[self.file]]:
            if reason := self._useless(slip):
                self.left_out.append((slip, reason))
            else:
                return slip
        raise RuntimeError(f"{self.file}: no slip is left for draw {number}")

    def _useless(self, slip: Spoiling) -> str:
        if (self.file, *slip.lines(self.text)) in EQUIVALENT:
            return "changes nothing, as equivalent.py argues"
        built = self._build(slip.spoil(self.text))
        return "does not compile" if built is None else "is the same program" if built == self._plain else ""


class Firmware:
    """A copy of the firmware in which one file changes; what does not depend on it is compiled once.

    Args:
        file: path below the project's folder.
        folder: for the copy; it is made.
    """

    def __init__(self, file: str, folder: Path) -> None:
        self._sources, self._out = folder / "firmware", folder / "out"
        self._file = self._sources / Path(file).name
        shutil.copytree(ROOT / FIRMWARE, self._sources, ignore=shutil.ignore_patterns("build"))

    def build(self, text: str) -> bytes | None:
        """Instructions and constants with this text of the file; None: the compiler refuses it.

        The firmware's number, a sum of its sources, is left out.
        """
        self._file.write_text(text, encoding="utf-8")
        target = self._out / "tepm.hex"
        target.unlink(missing_ok=True)
        command = ["make", "-s", "-C", str(self._sources), f"OUT={self._out}", "BUILD=0", str(target)]
        done = subprocess.run(command, capture_output=True, check=False)
        return target.read_bytes() if done.returncode == 0 else None


def code_of(text: str) -> object:
    """Instructions and constants of a Python module, without line numbers; None: it is no Python."""

    def parts(code: CodeType) -> tuple[object, ...]:
        constants = tuple(parts(each) if isinstance(each, CodeType) else (type(each), each) for each in code.co_consts)
        return code.co_code, code.co_exceptiontable, code.co_names, code.co_varnames, code.co_freevars, constants

    try:
        return parts(compile(text, "spoilt", "exec"))
    except SyntaxError:
        return None

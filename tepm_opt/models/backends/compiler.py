"""C to libraries: text is compiled once and kept under the hash of all it depends on."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import cache
from importlib import util
from pathlib import Path

from tepm_opt.models.backends import store

NONE = (
    "no C compiler found: everything works, with the same results, but some 10 to 70 times slower; "
    "valid: gcc or clang from your system's packages, or pip install ziglang"
)


FLAGS_VARIABLE = "TEPM_OPT_CFLAGS"
"""Environment variable with further flags of the compiler, which come last: `-O1` compiles twice as fast and computes half as fast."""


@cache
def find_compiler() -> tuple[str, ...] | None:
    """Command of a C compiler: $CC, cc, gcc, clang, or the PyPI package ziglang where that is installed; None without one."""
    for name in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        if name and (path := shutil.which(name)):
            return (path,)
    return (sys.executable, "-P", "-m", "ziglang", "cc") if util.find_spec("ziglang") else None


@cache
def _machine(compiler: tuple[str, ...]) -> str:
    version = subprocess.run([*compiler, "--version"], capture_output=True, text=True, check=False).stdout
    try:
        flags = next(line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith(("flags", "Features")))
    except (OSError, StopIteration):
        flags = platform.processor()
    return "\n".join((*compiler, version, platform.platform(), flags))


def build(text: str, stem: str, symbols: Sequence[str], flags: Sequence[str], instead: str) -> ctypes.CDLL | None:
    """The library of a C text, kept or compiled; None (and one warning) where that is not possible.

    Args:
        text: in C.
        stem: with which the names of its files begin.
        symbols: functions that are called from outside.
        flags: of the compiler.
        instead: what is used without it, for the warning where compiling fails.
    """
    compiler = find_compiler()
    if compiler is None:
        store.warn_once(NONE)
        return None
    flags = (*flags, *shlex.split(os.environ.get(FLAGS_VARIABLE, "")))
    key = hashlib.sha256("\n".join((text, *flags, _machine(compiler))).encode()).hexdigest()[:24]
    name = f"{stem}-{key}"
    try:
        with store.opened_folder() as folder:
            if library := store.load(folder, name, symbols):
                return library
            with store.turn(folder, name):
                if library := store.load(folder, name, symbols):
                    return library
                return store.open_library(store.keep(folder, name, _compile(compiler, text, flags)), symbols)
    except (OSError, subprocess.CalledProcessError, ValueError, AttributeError) as error:
        detail = getattr(error, "stderr", None) or str(error)
        store.warn_once(f"compiling failed: {instead}: {detail.strip().splitlines()[0]}")
        return None


def _compile(compiler: tuple[str, ...], text: str, flags: Sequence[str]) -> bytes:
    """The library of a C text.

    Raises:
        subprocess.CalledProcessError: the compiler refuses.
    """
    with tempfile.TemporaryDirectory(prefix="tepm_opt-") as folder:  # closed to others
        code, library = Path(folder) / "network.c", Path(folder) / "network.so"
        code.write_text(text, encoding="utf-8")
        command = [*compiler, *flags, "-shared", "-fPIC", "-o", str(library), str(code), "-lm"]
        subprocess.run(command, check=True, capture_output=True, text=True)
        return library.read_bytes()

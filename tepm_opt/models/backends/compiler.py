"""C to libraries: texts are compiled once, each to an object file that is kept under the hash of all it depends on, and linked."""

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
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import util
from itertools import count
from pathlib import Path

from tepm_opt.models.backends import store
from tepm_opt.progress import Progress, silent

NONE = (
    "no C compiler found: everything works, with the same results, but some 10 to 70 times slower; "
    "valid: gcc or clang from your system's packages, or pip install ziglang"
)


STAGE = "compiling kernels"
"""Name of the stage in which parts are compiled."""
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


_listeners: list[Progress] = []


@contextmanager
def report_to(progress: Progress) -> Iterator[None]:
    """Tell `progress` meanwhile how many parts are compiled, from whichever thread, instead of who was told before."""
    _listeners.append(progress)
    try:
        yield
    finally:
        _listeners.remove(progress)


@dataclass(frozen=True)
class Part:
    """A C text that is compiled alone.

    Attributes:
        name: with which the name of its object file begins.
        text: in C.
        flags: of the compiler.
    """

    name: str
    text: str
    flags: tuple[str, ...]


def build(parts: Sequence[Part], stem: str, symbols: Sequence[str], instead: str) -> ctypes.CDLL | None:
    """The library of some C texts, kept or compiled; None (and one warning) where that is not possible.

    Each text is an object file of its own, kept like the library: what other libraries share is compiled once. As many are compiled at
    the same time as there are cores.

    Args:
        parts: C texts.
        stem: with which the names of its files begin.
        symbols: functions that are called from outside.
        instead: what is used without it, for the warning where compiling fails.
    """
    compiler = find_compiler()
    if compiler is None:
        store.warn_once(NONE)
        return None
    try:
        names = [_name_of(part, compiler) for part in parts]
        name = f"{stem}-{_digest(*names)}"
        with store.opened_folder() as folder:
            if library := store.load(folder, name, symbols):
                return library
            with store.turn(folder, name):
                if library := store.load(folder, name, symbols):
                    return library
                objects = _compile_all(folder, compiler, parts, names)
                return store.open_library(store.keep(folder, name, _link(compiler, objects, parts[0].flags)), symbols)
    except (OSError, subprocess.CalledProcessError, ValueError, AttributeError) as error:
        detail = getattr(error, "stderr", None) or str(error)
        store.warn_once(f"compiling failed: {instead}: {detail.strip().splitlines()[0]}")
        return None


def _name_of(part: Part, compiler: tuple[str, ...]) -> str:
    return f"{part.name}-{_digest(part.text, *_flags_of(part, compiler), _machine(compiler))}"


def _digest(*texts: str) -> str:
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()[:24]


def _flags_of(part: Part, compiler: tuple[str, ...]) -> tuple[str, ...]:
    """Flags of a part, without those that only GCC knows where the compiler is another, and the user's last."""
    own = [flag for flag in part.flags if not flag.startswith("-fira-") or "Free Software Foundation" in _machine(compiler)]
    return (*own, *shlex.split(os.environ.get(FLAGS_VARIABLE, "")))


def _compile_all(folder: Path, compiler: tuple[str, ...], parts: Sequence[Part], names: Sequence[str]) -> list[bytes]:
    """Object files of all parts, the longest text first.

    Raises:
        subprocess.CalledProcessError: the compiler refuses.
    """

    progress, done = _listeners[-1] if _listeners else silent, count(1)

    def read_or_compile(part: Part, name: str) -> bytes:
        with store.turn(folder, name):
            content = store.read_file(folder, name, ".o")
            if content is None:
                content = _compile(compiler, part.text, _flags_of(part, compiler))
                store.keep(folder, name, content, ".o")
        progress(STAGE, next(done), len(parts))
        return content

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    progress(STAGE, 0, len(parts))
    pool = ThreadPoolExecutor(cores)
    try:
        jobs = {
            name: pool.submit(read_or_compile, part, name)
            for part, name in sorted(zip(parts, names, strict=True), key=_length, reverse=True)
        }
        return [jobs[name].result() for name in names]
    finally:
        pool.shutdown(cancel_futures=True)


def _length(job: tuple[Part, str]) -> int:
    return len(job[0].text)


def _compile(compiler: tuple[str, ...], text: str, flags: Sequence[str]) -> bytes:
    """The object file of a C text.

    Raises:
        subprocess.CalledProcessError: the compiler refuses.
    """
    with tempfile.TemporaryDirectory(prefix="tepm_opt-") as folder:  # closed to others
        code, made = Path(folder) / "part.c", Path(folder) / "part.o"
        code.write_text(text, encoding="utf-8")
        subprocess.run([*compiler, *flags, "-fPIC", "-c", "-o", str(made), str(code)], check=True, capture_output=True, text=True)
        return made.read_bytes()


def _link(compiler: tuple[str, ...], objects: Sequence[bytes], flags: Sequence[str]) -> bytes:
    """The library of object files.

    Raises:
        subprocess.CalledProcessError: the linker refuses.
    """
    with tempfile.TemporaryDirectory(prefix="tepm_opt-") as folder:
        files = [Path(folder) / f"{k}.o" for k in range(len(objects))]
        for file, content in zip(files, objects, strict=True):
            file.write_bytes(content)
        library, sanitizers = Path(folder) / "library.so", [flag for flag in flags if flag.startswith("-fsanitize")]
        command = [*compiler, *sanitizers, "-shared", "-o", str(library), *map(str, files), "-lm"]
        subprocess.run(command, check=True, capture_output=True, text=True)
        return library.read_bytes()

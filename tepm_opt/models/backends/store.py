"""Compiled libraries between runs, in a folder that belongs to one user alone: a library is code, and runs as whoever loads it."""

from __future__ import annotations

import ctypes
import hashlib
import multiprocessing
import os
import stat
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

import platformdirs

from tepm_opt.data.files import atomic_path

try:
    import fcntl
except ImportError:  # not on Windows
    fcntl = None

CACHE_VARIABLE = "TEPM_OPT_CACHE"
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


def cache_folder() -> Path:
    """Folder in which libraries are kept: $TEPM_OPT_CACHE or the user's cache folder."""
    return Path(os.environ.get(CACHE_VARIABLE) or platformdirs.user_cache_path("tepm_opt"))


@contextmanager
def opened_folder() -> Iterator[Path]:
    """The cache folder, made if need be; where it cannot be, or others can write into it, a folder of this process, with one warning.

    The path that is given leads to this very folder, whatever is put in its place meanwhile.
    """
    folder = cache_folder()
    try:
        handle = _open_folder(folder)
    except OSError as error:
        folder = Path(_own_folder(f"{folder}: {error.strerror}").name)
        handle = _open_folder(folder)
    if handle is None:
        yield folder
        return
    try:
        held = Path(f"/proc/self/fd/{handle}")
        yield held if held.is_dir() else folder
    finally:
        os.close(handle)


def _open_folder(folder: Path) -> int | None:
    """A handle of a folder that only the own user can write into; None on Windows, where a user's folders are closed to others.

    Raises:
        OSError: it cannot be made, or others can write into it.
    """
    if folder.is_symlink():
        raise PermissionError(0, "is a symbolic link, which may come to lead elsewhere")
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if os.name != "posix":
        return None
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        _check_owner(os.fstat(handle))
    except PermissionError:
        os.close(handle)
        raise
    return handle


def _check_owner(found: os.stat_result) -> None:
    """Raise a PermissionError where another user can write."""
    if found.st_uid != os.geteuid():
        raise PermissionError(0, f"belongs to user {found.st_uid}, not to {os.geteuid()}")
    if found.st_mode & _OTHERS_WRITE:
        raise PermissionError(0, f"may be written by others (mode {stat.S_IMODE(found.st_mode):o})")


@cache
def _own_folder(reason: str) -> tempfile.TemporaryDirectory[str]:
    """A folder that lasts as long as this process."""
    warn_once(f"compiled models are not kept: {reason}; valid: a folder of your own that nobody else can write into, in ${CACHE_VARIABLE}")
    return tempfile.TemporaryDirectory(prefix="tepm_opt-", ignore_cleanup_errors=True)


def load(folder: Path, name: str, symbols: Sequence[str]) -> ctypes.CDLL | None:
    """The library of a name that was kept; None where there is none that is whole, the own user's, and has these symbols."""
    for path, _ in _read_intact_files(folder, name, ".so"):
        try:
            return open_library(path, symbols)
        except (OSError, AttributeError):
            continue
    return None


def read_file(folder: Path, name: str, suffix: str) -> bytes | None:
    """The file of a name that was kept; None where there is none that is whole and the own user's."""
    return next((content for _, content in _read_intact_files(folder, name, suffix)), None)


def _read_intact_files(folder: Path, name: str, suffix: str) -> Iterator[tuple[Path, bytes]]:
    """Read the files of a name that are as they were written, and the own user's, with their contents."""
    for path in sorted(folder.glob(f"{name}-*{suffix}")):
        try:
            content = _read(path)
        except OSError:
            continue
        if path.stem == f"{name}-{_digest(content)}":
            yield path, content


def open_library(path: Path, symbols: Sequence[str]) -> ctypes.CDLL:
    """A library that is to be trusted.

    Raises:
        OSError: it cannot be loaded.
        AttributeError: one of the symbols is not in it.
    """
    library = ctypes.CDLL(str(path))
    for symbol in symbols:
        getattr(library, symbol)
    return library


def keep(folder: Path, name: str, content: bytes, suffix: str = ".so") -> Path:
    """Keep a library or another file, which replaces all others of that name and appears when it is whole.

    The digest in its name tells if it still is.

    Args:
        folder: of all of them.
        name: with the hash of all that it depends on.
        content: of the file.
        suffix: ".so" of a library, ".o" of an object file, ".functions" of a model's functions.

    Raises:
        InputError: the folder cannot be written to.
    """
    path = folder / f"{name}-{_digest(content)}{suffix}"
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)
        temporary.chmod(0o600)
    for other in folder.glob(f"{name}-*{suffix}"):
        if other.name != path.name:
            with suppress(OSError):  # Windows keeps what is loaded
                other.unlink()
    return path


def _read(path: Path) -> bytes:
    """The content of a regular file that only the own user can write.

    Raises:
        OSError: it is no such file.
    """
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with os.fdopen(handle, "rb") as file:
        found = os.fstat(handle)
        if not stat.S_ISREG(found.st_mode):
            raise PermissionError(0, "is no regular file")
        if os.name == "posix":
            _check_owner(found)
        return file.read()


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:24]


@contextmanager
def turn(folder: Path, name: str) -> Iterator[None]:
    """Wait for another process that compiles the same library; the system ends the turn of a process that dies."""
    if fcntl is None:
        yield  # two processes may compile the same, and the last one stays
        return
    lock = folder / f"{name}.lock"
    with lock.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        try:
            yield
        finally:
            lock.unlink(missing_ok=True)


@cache
def warn_once(message: str) -> None:
    """Warn, once a process; not in processes that help another, which has said it."""
    if multiprocessing.parent_process() is None:
        warnings.warn(message, RuntimeWarning, stacklevel=4)

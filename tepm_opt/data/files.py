"""Files that are whole or absent: everything is written under a temporary name and renamed."""

from __future__ import annotations

import glob
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tepm_opt.errors import InputError


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """A temporary path beside `path` that takes its name when the block ends without an exception.

    Raises:
        InputError: the folder cannot be written to.
    """
    path = Path(path)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent)
        os.close(handle)
        Path(name).chmod(0o666 & ~_umask())
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error
    try:
        yield Path(name)
        try:
            _to_disk(name)
            Path(name).replace(path)
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from error
    finally:
        Path(name).unlink(missing_ok=True)


def remove_leftovers(path: str | Path) -> None:
    """Remove the temporary files that a program killed while it wrote `path` has left beside it."""
    path = Path(path)
    for leftover in path.parent.glob(f".{glob.escape(path.stem)}.????????{glob.escape(path.suffix)}"):
        leftover.unlink(missing_ok=True)


def _to_disk(name: str) -> None:
    """Wait until the file's content is stored, so that a power cut after the renaming cannot leave it empty."""
    handle = os.open(name, os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def write_atomically(path: str | Path, text: str) -> None:
    """Write a text file as a whole.

    Raises:
        InputError: the folder cannot be written to.
    """
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def output_folder(path: str | Path) -> Path:
    """The folder for results, made if need be.

    Raises:
        InputError: it is a file, or cannot be made or written to.
    """
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise InputError(f"output folder {path} is a file; name a folder") from error
    except OSError as error:
        raise InputError(f"output folder {path} cannot be made: {error.strerror}") from error
    if not os.access(path, os.W_OK):
        raise InputError(f"output folder {path} is read-only; name another")
    return path

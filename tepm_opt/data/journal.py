"""A table that grows line by line and survives what ends the program: each row is with the system before the next one is measured."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

from tepm_opt.data.tables import csv_text
from tepm_opt.errors import InputError

SYNC = 1.0
"""Seconds between waits for the disk: that much a power cut may cost; the program's own end costs nothing."""


class Journal:
    """A CSV file that rows are appended to. A context manager.

    Args:
        path: of the new file.
        names: its header.

    Raises:
        InputError: the file exists or cannot be written.
    """

    def __init__(self, path: str | Path, names: Sequence[str]) -> None:
        self.path = Path(path)
        try:
            self._file = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o666)
        except FileExistsError as error:
            raise InputError(f"{path} exists; rename or remove it") from error
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from error
        self._synced = time.monotonic()
        self.append(names)

    def append(self, *rows: Sequence[str]) -> None:
        """Write rows of fields; line breaks in a field become spaces.

        Raises:
            InputError: the disk is full or gone.
        """
        whole = [[" ".join(field.splitlines()) for field in row] if len(",".join((*row, "")).splitlines()) > 1 else row for row in rows]
        text = csv_text(whole).encode()
        try:
            while text:
                text = text[os.write(self._file, text) :]
            if time.monotonic() - self._synced > SYNC:
                os.fsync(self._file)
                self._synced = time.monotonic()
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written: {error.strerror}") from error

    def close(self) -> None:
        """Wait for the disk and close."""
        if self._file >= 0:
            os.fsync(self._file)
            os.close(self._file)
            self._file = -1

    def __enter__(self) -> Journal:
        """The journal itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Close."""
        self.close()


def mend_journal(path: str | Path) -> int:
    """Cut off a last line that was not finished; the number of whole rows under the header."""
    content = Path(path).read_bytes()
    whole = content[: content.rfind(b"\n") + 1]
    if len(whole) < len(content):
        os.truncate(path, len(whole))
    return max(whole.count(b"\n") - 1, 0)

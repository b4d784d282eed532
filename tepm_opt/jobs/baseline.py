"""Baselines of the discrepancy workflow in files: learned from a data set, or read from what was written then."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tepm_opt.data.documents import read_json
from tepm_opt.data.files import write_atomically
from tepm_opt.discrepancy.baseline.baseline import Baseline
from tepm_opt.discrepancy.pipeline import learn_baseline
from tepm_opt.discrepancy.stages import prepare
from tepm_opt.discrepancy.state import Question
from tepm_opt.errors import InputError
from tepm_opt.progress import with_prefix

BASELINE = "baseline.json"


@dataclass(frozen=True)
class BaselineFile:
    """An earlier recording: its data set, and what was learned from it before.

    Attributes:
        folder: data set.
        file: `baseline.json` of an earlier command; None where it has to be learned.
        content: of the file.
    """

    folder: Path
    file: Path | None = None
    content: Mapping[str, Any] | None = None

    @classmethod
    def open(cls, path: Path) -> BaselineFile:
        """A data set's folder as it is; a file with the folder that it names.

        Args:
            path: folder of a data set, or a `baseline.json`.

        Raises:
            InputError: the file is damaged or names no folder.
        """
        if not path.is_file():
            return cls(path)
        content = read_json(path, "tepm discrepancy --baseline with the data set")
        data = content.get("data")
        if not isinstance(data, str):
            raise InputError(f"{path}: names no data; valid: a {BASELINE} that tepm discrepancy --baseline wrote, or a data set")
        folder = Path(os.path.normpath(path.parent / data))
        if not folder.is_dir():
            raise InputError(f"{path}: its data set {folder} is not there; valid: the file where it was written, or the data set's folder")
        return cls(folder, path, content)

    def learn(self, question: Question, machine: Sequence[str], out: Path) -> Baseline:
        """The baseline, fitted unless it was before; it is written into a folder, too.

        Args:
            question: about this data set.
            machine: everything that the answer depends on besides the data.
            out: folder for `baseline.json`.

        Raises:
            InputError: see `learn_baseline`; or the data, the model or this package have changed since the file was written.
        """
        key, progress = fingerprint([self.folder], *machine), question.progress
        if self.content is None or self.file is None:
            progress(f"fitting the model to {question.dataset.name}", 0, 0)
            found = learn_baseline(replace(question, progress=with_prefix(progress, "baseline")))
        elif self.content.get("key") != key:
            raise InputError(f"{self.file}: the data, the model or tepm-opt are not those of then; valid: --baseline {self.folder}")
        else:
            found = Baseline.from_json(self.content, prepare(question).problem.runs, self.file)
        data = Path(os.path.relpath(self.folder, out)).as_posix()
        write_atomically(out / BASELINE, json.dumps({**found.as_json(), "data": data, "key": key}, indent=2) + "\n")
        return found


def fingerprint(folders: Sequence[Path], *parts: str) -> str:
    """Changes with the data, these parts and the version of this package."""
    digest = hashlib.sha256(repr((*parts, version("tepm-opt"))).encode())
    for path in (each for folder in folders for each in sorted(folder.glob("*"))):
        if path.is_file():
            digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()

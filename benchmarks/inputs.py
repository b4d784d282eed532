"""Checks of the command line, before anything is compiled."""

from __future__ import annotations

import os
from pathlib import Path

from tepm_opt.errors import InputError

ROBOT = "kang2017"
DESCRIPTION = "dataset.toml"


def checked_limit(folder: Path | None) -> None:
    """Refuse a folder without the practical limit.

    Raises:
        InputError: it has no time_limit.py.
    """
    if folder is not None and not (folder / "time_limit.py").is_file():
        raise InputError(f"--limit {folder}: no time_limit.py there; valid: the folder of that script, or no --limit and no TEPM_LIMIT")


def checked_file(option: str, path: Path | None) -> None:
    """Refuse a file that cannot be written.

    Raises:
        InputError: its folder is not there or closed, or it is a folder.
    """
    if path is not None and (path.is_dir() or not path.parent.is_dir() or not os.access(path.parent, os.W_OK)):
        raise InputError(f"{option} {path}: not a file in a folder that can be written to")


def checked_reference(folder: Path | None) -> Path | None:
    """A data set that can be simulated, read once.

    Raises:
        InputError: no data set, of another robot, or of equilibria.
    """
    if folder is None:
        return None
    from tepm_opt.models.channels import read

    _described(folder, "--reference")
    found = read(folder).usable
    if found.robot != ROBOT or found.static:
        what = "equilibria" if found.static else f"runs of {found.robot}"
        raise InputError(f"--reference {folder}: {what}; valid: a data set of motions of {ROBOT}")
    return folder


def data_sets(folder: Path | None) -> tuple[Path, ...]:
    """A data set, or all those in a folder, by name.

    Raises:
        InputError: there is none.
    """
    if folder is None:
        return ()
    if not (folder / DESCRIPTION).is_file() and (found := sorted(path.parent for path in folder.glob(f"*/{DESCRIPTION}"))):
        return tuple(found)
    _described(folder, "--data")
    return (folder,)


def _described(folder: Path, option: str) -> None:
    if not (folder / DESCRIPTION).is_file():
        raise InputError(f"{option} {folder}: no {DESCRIPTION} there; valid: the folder of a data set (docs/how-to/recording.md)")

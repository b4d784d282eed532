"""Templates of packages with a tracker or a rig: installable, with an example that works and its tests."""

from __future__ import annotations

import keyword
import re
import shutil
import tempfile
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Literal

from tepm_opt.errors import InputError

Template = Literal["tracker", "rig"]
NAME = re.compile(r"[a-z][a-z0-9_]*")


def write_package(template: Template, name: str, folder: Path) -> tuple[Path, ...]:
    """Write a package from a template into a folder that is not there yet; the files, relative to it.

    Args:
        template: which one.
        name: of the kind, and of the module `tepm_NAME`.
        folder: to be made, as a whole or not at all.

    Raises:
        InputError: the name is no identifier, or the folder is there or cannot be made.
    """
    if not NAME.fullmatch(name) or keyword.iskeyword(name):
        raise InputError(f"name {name!r}; valid: small letters, digits and _, beginning with a letter")
    if folder.exists():
        raise InputError(f"{folder} exists; name another folder with --out")
    words = {"@NAME@": name, "@MODULE@": f"tepm_{name}", "@CLASS@": "".join(part.title() for part in name.split("_"))}
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        try:
            written = _copy(files(__name__) / template, made, words)
            made.chmod(0o755)
            made.rename(folder)
        finally:
            shutil.rmtree(made, ignore_errors=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from error
    return tuple(sorted(path.relative_to(made) for path in written))


def _copy(source: Traversable, target: Path, words: dict[str, str]) -> list[Path]:
    """Copy a folder of templates (files end with `.in`), with words in texts and names replaced."""
    written = []
    for entry in source.iterdir():
        path = target / _fill_in(entry.name.removesuffix(".in"), words)
        if entry.is_dir():
            path.mkdir()
            written += _copy(entry, path, words)
        elif entry.name.endswith(".in"):
            path.write_text(_fill_in(entry.read_text(encoding="utf-8"), words), encoding="utf-8", newline="\n")
            written.append(path)
    return written


def _fill_in(text: str, words: dict[str, str]) -> str:
    for word, by in words.items():
        text = text.replace(word, by)
    return text

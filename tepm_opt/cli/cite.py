"""`tepm cite`: works to cite for the toolkit, the robot, the methods and the effects of a model."""

from __future__ import annotations

import tomllib
from enum import StrEnum
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from tepm_opt.cli.common import SOLVED

SOURCES = "sources.toml"
KIND, USED = "kind", "used"
ESCAPES = str.maketrans({"_": r"\_", "&": r"\&", "^": r"\^{}", "%": r"\%"})
"""Characters that mean something else to TeX."""


class Form(StrEnum):
    """Form of the answer."""

    TEXT = "text"
    BIBTEX = "bibtex"


def cite(
    form: Annotated[Form, typer.Option("--format", help="Lines to read, or entries for BibTeX.")] = Form.TEXT,
    model: Annotated[Path | None, typer.Option("--model", help="Model file: cite the sources of its effects, too.")] = None,
) -> int:
    """Print whom to cite: the toolkit, the paper of the robot, and the source of every method and of a model's effects."""
    works = read_sources()
    if model is not None:
        from tepm_opt.models.effects import find_effect
        from tepm_opt.models.model import read_model

        for name in dict.fromkeys(effect.name for effect in read_model(model).effects):
            works[name] = {KIND: "misc", "title": find_effect(name).reference, USED: f"effect {name}"}
    for key, work in works.items():
        print(format_bibtex(key, work) if form is Form.BIBTEX else f"{work[USED]}:\n    {format_text(work)}")
    return SOLVED


def read_sources() -> dict[str, dict[str, str]]:
    """Works by their BibTeX key: the toolkit in its installed version first, then the robot's paper, then methods."""
    text = resources.files("tepm_opt.cli").joinpath(SOURCES).read_text(encoding="utf-8")
    works = {key: {name: str(value) for name, value in work.items()} for key, work in tomllib.loads(text).items()}
    works["tepm_opt"]["version"] = version("tepm-opt")
    return works


def format_text(work: dict[str, str]) -> str:
    """A work in a line: authors, title, place, year."""
    author = work.get("author", "").strip("{}").replace(" and ", "; ")
    number = f"version {work['version']}" if "version" in work else ""
    place = next((work[name] for name in ("journal", "booktitle", "publisher") if name in work), "")
    return ", ".join(part for part in (author, work["title"], place, number, work.get("year", "")) if part)


def format_bibtex(key: str, work: dict[str, str]) -> str:
    """A work as a BibTeX entry; its note says what rests on it."""
    fields = {**{name: text for name, text in work.items() if name not in (KIND, USED)}, "note": work[USED]}
    fields["title"] = f"{{{fields['title']}}}"  # keeps capitals
    lines = [f"  {name} = {{{text.translate(ESCAPES)}}}," for name, text in fields.items()]
    return "\n".join([f"@{work[KIND]}{{{key},", *lines, "}"])

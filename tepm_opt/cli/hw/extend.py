"""`tepm hw trackers`, `tepm hw new-tracker` and `tepm hw new-rig`: kinds that are there, and packages for others."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from tepm_opt.cli.common import SOLVED, JsonOption, stdout
from tepm_opt.cli.hw.shared import say

if TYPE_CHECKING:
    from tepm_opt.hw.templates import Template

NameArgument = Annotated[str, typer.Argument(metavar="NAME", help="Of the kind: small letters, digits and _.")]
FolderOption = Annotated[Path | None, typer.Option("--out", metavar="FOLDER", help="New folder of the package.", show_default="tepm-NAME")]


def trackers(as_json: JsonOption = False) -> int:
    """List the kinds of trackers, and whether the package that each needs is installed."""
    from tepm_opt.hw.trackers import tracker_kinds

    kinds = [(kind, _find_missing(kind.needs)) for kind in tracker_kinds()]
    if as_json:
        found = [
            {"kind": kind.name, "description": kind.description, "installed": not missing, "port": kind.port} for kind, missing in kinds
        ]
        print(json.dumps(found, indent=2))
        return SOLVED
    table = Table("kind", "description", "options", "installed")
    for kind, missing in kinds:
        table.add_row(kind.name, kind.description, ", ".join(kind.options.model_fields) or "none", f"no: {missing}" if missing else "yes")
    stdout.print(table)
    say('The robot file names one: kind = "…" of [hardware.tracker]; docs/how-to/trackers.md has examples.')
    return SOLVED


def _find_missing(module: str) -> str:
    """The module's name where it is not installed, else nothing."""
    return module if module and find_spec(module.partition(".")[0]) is None else ""


def new_tracker(name: NameArgument, out: FolderOption = None) -> int:
    """Write an installable package with a tracker of your own: a working example, its tests, a README."""
    return _write("tracker", name, out)


def new_rig(name: NameArgument, out: FolderOption = None) -> int:
    """Write an installable package with a rig of your own: a working example, its tests, a README."""
    return _write("rig", name, out)


def _write(template: Template, name: str, out: Path | None) -> int:
    from tepm_opt.hw.templates import write_package

    folder = out or Path(f"tepm-{name}")
    files = write_package(template, name, folder)
    say(f"{folder}: {', '.join(str(path) for path in files)}", "bold")
    say(f"Install and test it: cd {folder} && pip install -e '.[test]' && pytest")
    return SOLVED

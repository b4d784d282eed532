"""The page on the commands of `tepm`, from the program itself."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import typer.main

from tepm_opt.cli.program import app

BEGINNING = """# Commands

What `tepm COMMAND --help` says, of every command. The exit status is 0 only when everything was solved, 1 when something was not,
2 for wrong input, 130 when interrupted.
"""


def page() -> str:
    """Every command with its usage, arguments and options."""
    text = [BEGINNING]
    for path, command in commands("tepm", typer.main.get_command(app)):
        context = command.make_context(path, [], resilient_parsing=True)
        rows = [_row(parameter, context) for parameter in command.get_params(context) if parameter.name != "help" and not parameter.hidden]
        text += [f"## {path}", "", _plain(command.help or ""), "", "```text", f"{path} {_usage(command, context)}", "```", ""]
        text += ["| argument or option | default | what it is |", "| --- | --- | --- |", *rows, ""] if rows else []
    return "\n".join(text)


def commands(path: str, command: Any) -> Iterator[tuple[str, Any]]:
    """Commands with how each is called, groups opened; old names are left out."""
    inner = getattr(command, "commands", None)
    if inner is None:
        yield path, command
        return
    for name in command.list_commands(None):
        if not inner[name].hidden:
            yield from commands(f"{path} {name}", inner[name])


def _usage(command: Any, context: Any) -> str:
    return re.sub(r"[{}]", "", " ".join(command.collect_usage_pieces(context)))


def _row(parameter: Any, context: Any) -> str:
    named, told = parameter.get_help_record(context)
    told = re.sub(r"\s*\[(?:default:.*|required)\]\s*$", "", told)
    default = parameter.default
    plain = default is None or default is False or default is ... or callable(default) or parameter.required
    shown = "" if plain else f"`{getattr(default, 'value', default)}`"
    return f"| `{named}` | {shown} | {_plain(told)} |".replace("|>", "\\|>")


def _plain(text: str) -> str:
    """Words without the terminal's marks, safe in Markdown and in a table."""
    text = re.sub(r"\[/?(?:bold|italic|dim)?\]", "", text)
    return re.sub(r"([<*_|$])", r"\\\1", re.sub(r"\s+", " ", text)).strip()

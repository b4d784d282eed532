"""Documents: their commands exist, their Python does what it says, their words are spelt as they are elsewhere."""

from __future__ import annotations

import ast
import doctest
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer.main

from tepm_opt.cli.program import app
from tests.docs.texts import DOCUMENTS, ROOT, answers, steps

PROGRAM = typer.main.get_command(app)


def problem(words: list[str]) -> str:
    """What is wrong with a command line, or nothing: no such command, no such option."""
    command: Any = PROGRAM
    rest = words[1:]
    while getattr(command, "commands", None) and rest and not rest[0].startswith("-"):
        if rest[0] not in command.commands:
            return f"no command {rest[0]!r}"
        command, rest = command.commands[rest[0]], rest[1:]
    known = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)} | {"--help"}
    unknown = [word for word in rest if re.fullmatch(r"--[a-z][\w-]*", word.partition("=")[0]) and word.partition("=")[0] not in known]
    return f"no option {unknown}" if unknown else ""


def test_commands_and_options_exist() -> None:
    found = [(path.name, step.text, problem(step.words)) for path in DOCUMENTS for step in steps(path) if step.words]
    assert len(found) > 50
    assert [each for each in found if each[2]] == []


def test_every_question_has_a_command() -> None:
    page = ROOT / "docs" / "how-to" / "choose.md"
    found = answers(page)
    assert len(found) == page.read_text(encoding="utf-8").count("\n- **") > 20
    assert [(step.text, wrong) for step in found if (wrong := problem(step.words))] == []


def test_a_wrong_command_would_be_seen() -> None:
    assert problem(["tepm", "ik", "circle", "--out", "run"]) == ""
    assert problem(["tepm", "ki", "circle"]) == "no command 'ki'"
    assert problem(["tepm", "data", "check", "bench", "--oops"]) == "no option ['--oops']"


@pytest.mark.parametrize("name", ["docs/tutorial.md", pytest.param("README.md", marks=pytest.mark.slow)])
def test_python_does_what_it_says(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks of Python run, and examples with a prompt give what stands below them."""
    monkeypatch.chdir(tmp_path)
    text = (ROOT / name).read_text(encoding="utf-8")
    blocks = re.findall(r"^```(?:python|pycon)\n(.*?)^```", text, re.S | re.M)
    assert blocks
    for block in blocks:
        if ">>>" in block:
            examples = doctest.DocTestParser().get_doctest(block, {}, name, name, 0)
            told: list[str] = []
            failed = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(examples, out=told.append)
            assert failed.attempted
            assert failed.failed == 0, "".join(told)
        else:
            exec(compile(block, name, "exec"), {})


def docstrings() -> str:
    """All docstrings of the package, after the names of their files."""
    found = []
    for path in sorted((ROOT / "tepm_opt").rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        found.append(f"{path.relative_to(ROOT)}")
        owners = (node for node in ast.walk(tree) if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef))
        found += [ast.get_docstring(node) or "" for node in owners]
    return "\n".join(found)


def spelling(text: str) -> str:
    """What codespell finds wrong in a text."""
    tool = shutil.which("codespell", path=str(Path(sys.executable).parent))
    if tool is None:
        pytest.skip("codespell is not installed (extra dev)")
    return subprocess.run([tool, "-"], input=text, cwd=ROOT, capture_output=True, text=True, check=False).stdout


@pytest.mark.slow
def test_spelling() -> None:
    texts = {path.name: path.read_text(encoding="utf-8") for path in DOCUMENTS} | {"docstrings": docstrings()}
    assert {name: found for name, text in texts.items() if (found := spelling(text))} == {}
    assert "receive" in spelling("to recieve\n")

"""What keeps the house in order: style, types, import contracts, files, docstrings. Tools that are not installed are skipped."""

from __future__ import annotations

import ast
import pkgutil
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

from tepm_opt.models.effects import STANDARD, effects

ROOT = Path(__file__).parent.parent
PACKAGE = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in sorted((ROOT / "tepm_opt").rglob("*.py"))}
parse = cache(ast.parse)
LINES, BYTES = 400, 22_000
"""Of a file. The second keeps the first from being met by long lines."""


def run(tool: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A tool of this environment, run on the project."""
    path = shutil.which(tool, path=str(Path(sys.executable).parent))
    if path is None:
        pytest.skip(f"{tool} is not installed (extra dev)")
    return subprocess.run([path, *arguments], cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("arguments", [("check",), ("format", "--check")])
def test_style(arguments: tuple[str, ...]) -> None:
    done = run("ruff", *arguments)
    assert done.returncode == 0, done.stdout + done.stderr


def test_import_contracts() -> None:
    done = run("lint-imports")
    kept = re.search(r"Contracts: (\d+) kept, (\d+) broken", done.stdout)
    assert kept, done.stdout + done.stderr
    declared = (ROOT / "pyproject.toml").read_text(encoding="utf-8").count("[[tool.importlinter.contracts]]")
    assert (int(kept[1]), int(kept[2])) == (declared, 0), done.stdout + done.stderr


def test_no_effect_is_named_outside_its_folder() -> None:
    """Neither alone nor as the start of a parameter's full name; the rig's imperfections, any machine's laws and what blind
    trials hide may share names."""
    package = ROOT / "tepm_opt"
    allowed = [
        package / "models" / "effects",
        package / "hw" / "simulation" / "imperfections",
        package / "discrepancy" / "laws",
        package / "studies" / "blind",
    ]
    names = "|".join(effect.name for effect in (*effects(), *STANDARD))
    named = re.compile(rf"(?:{names})(?:\[.*\])?(?:\.\w*)?")
    assert named.fullmatch("actuator_gain[13].loss")
    quoted = re.compile(rf"""["'](?:{names})""")  # worth a closer look: docstrings quote names, too
    texts = {path: text for path, text in PACKAGE.items() if not any((ROOT / path).is_relative_to(folder) for folder in allowed)}
    nodes = [(path, node) for path, text in texts.items() if quoted.search(text) for node in ast.walk(parse(text))]
    literals = [(path, node) for path, node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)]
    found = [f"{path}: line {node.lineno}: {node.value!r}" for path, node in literals if named.fullmatch(str(node.value))]
    assert not found


@pytest.mark.slow
def test_types() -> None:
    done = run("pyright", "--pythonpath", sys.executable)
    if not re.search(r"\d+ errors?, ", done.stdout):
        pytest.skip(f"pyright cannot start here: {(done.stdout + done.stderr).strip()[-200:]}")
    assert done.stdout.startswith("0 errors") or "\n0 errors" in done.stdout, done.stdout


def test_files_fit_a_few_screens() -> None:
    assert len(PACKAGE) > 150
    assert not {path: text.count("\n") for path, text in PACKAGE.items() if text.count("\n") > LINES}
    assert not {path: len(text) for path, text in PACKAGE.items() if len(text) > BYTES}


def public(text: str) -> Iterator[tuple[bool, ast.FunctionDef | ast.ClassDef]]:
    """Public functions and classes of a module, then public methods; whether they belong to the module itself."""
    for node in parse(text).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield True, node
            inner = node.body if isinstance(node, ast.ClassDef) else []
            yield from ((False, each) for each in inner if isinstance(each, ast.FunctionDef) and not each.name.startswith("_"))


@pytest.fixture(scope="module")
def definitions() -> list[tuple[str, bool, str, str]]:
    """Path, whether it belongs to the module itself, name and docstring of all that is public."""
    return [(path, own, node.name, ast.get_docstring(node) or "") for path, text in PACKAGE.items() for own, node in public(text)]


@pytest.mark.slow
def test_docstrings_can_be_read_alone(definitions: list[tuple[str, bool, str, str]]) -> None:
    """A tooltip shows them without the name's context: they begin with a noun or a verb. Methods may inherit theirs."""
    hanging = re.compile(r"(Of|By|With|From|For|To|In|On|At|As|And|Or|But|Than|Also|Because)\b")
    assert not [(path, name) for path, own, name, text in definitions if own and not text]
    assert not [(path, name, text) for path, _, name, text in definitions if hanging.match(text)]


def parameters(function: ast.FunctionDef) -> list[ast.arg]:
    """All parameters of a function but `self`, `cls`, `*` and `**`."""
    every = function.args
    return [each for each in (*every.posonlyargs, *every.args, *every.kwonlyargs) if each.arg not in ("self", "cls")]


def described(text: str) -> Iterator[tuple[str, str, list[ast.arg]]]:
    """Name, docstring and parameters of all public functions and methods; a class stands for its `__init__`."""
    for _, node in public(text):
        if isinstance(node, ast.FunctionDef):
            yield node.name, ast.get_docstring(node) or "", parameters(node)
            continue
        for made in node.body:
            if isinstance(made, ast.FunctionDef) and made.name == "__init__":
                yield node.name, (ast.get_docstring(node) or "") + (ast.get_docstring(made) or ""), parameters(made)


def test_the_page_on_verdicts_lists_every_effect() -> None:
    page = (ROOT / "docs" / "how-to" / "discrepancy.md").read_text(encoding="utf-8")
    _, _, known = page.partition("## What it knows")
    listed = known.partition("\n## ")[0]
    assert [effect.name for effect in effects() if f"`{effect.name}`" not in listed] == []


@pytest.mark.slow
def test_four_arguments_are_described() -> None:
    """Args names all of them. Commands describe theirs as options; a method without words has those of the one it overrides."""
    many = [(path, *each) for path, text in PACKAGE.items() for each in described(text) if len(each[2]) >= 4]
    assert len(many) > 100
    inherited = {name for _, name, text, _ in many if "Args:" in text}
    found = []
    for path, name, text, arguments in many:
        command = any(re.search(r"typer\.|Option", ast.unparse(each.annotation)) for each in arguments if each.annotation)
        if command or text.startswith("See `") or (not text and name in inherited):
            continue
        _, _, listed = text.partition("Args:")
        found += [f"{path}: {name}: {each.arg}" for each in arguments if not re.search(rf"\b{each.arg}\b", listed)]
    assert not found


def test_documents_name_what_exists() -> None:
    """Files, dotted names and imports in README, CONTRIBUTING and docs/; two dotted names are groups of entry points, not modules."""
    missing = []
    for path in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))):
        text = path.read_text(encoding="utf-8")
        missing += [
            (path.name, name) for name in re.findall(r"\b(?:tepm_opt|tests|benchmarks)/[\w/]+\.\w+", text) if not (ROOT / name).exists()
        ]
        blocks = [ast.parse(block) for block in re.findall(r"```python\n(.*?)```", text, re.S)]
        imports = [node for block in blocks for node in ast.walk(block) if isinstance(node, ast.ImportFrom)]
        names = {f"{node.module}.{alias.name}" for node in imports for alias in node.names}
        names |= set(re.findall(r"\btepm_opt(?:\.\w+)+", text)) - {"tepm_opt.effects", "tepm_opt.controllers"}
        for name in sorted(names):
            try:
                pkgutil.resolve_name(name)
            except (ImportError, AttributeError):
                missing.append((path.name, name))
    assert not missing


def test_documents_name_tests_that_exist() -> None:
    """Every `test_…` in docs/ is a test or a file of tests."""
    there = {path.name for path in (ROOT / "tests").rglob("test_*.py")}
    for path in (ROOT / "tests").rglob("test_*.py"):
        there |= set(re.findall(r"^def (test_\w+)", path.read_text(encoding="utf-8"), re.M))
    named = {
        (path.name, name)
        for path in sorted((ROOT / "docs").rglob("*.md"))
        for name in re.findall(r"\b(test_\w+(?:\.py)?)", path.read_text(encoding="utf-8"))
    }
    assert {(path, name) for path, name in named if name not in there} == set()


def test_benchmarks_can_be_imported() -> None:
    for path in sorted((ROOT / "benchmarks").glob("*.py")):
        import_module(f"benchmarks.{path.stem}")

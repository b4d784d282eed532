"""The program starts at once: help and typing errors import nothing that takes long; names of the package come when they are used."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import tepm_opt
from tepm_opt import plots, studies
from tepm_opt.cli.program import app

HEAVY = {"casadi", "control", "matplotlib", "mujoco", "scipy", "sklearn"}
IMPORTED = """
import sys
from tepm_opt.cli import run
status = run(sys.argv[1:])
print(status, *(name for name in {heavy} if name in sys.modules), file=sys.stderr)
"""
INTERRUPTED = """
import sys
class Person:
    @staticmethod
    def find_spec(name, *others):
        if name == "{module}":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Person)
from tepm_opt.cli import main
main()
"""
COMMANDS = sorted(str(command.name) for command in app.registered_commands)
WRONG = (["nosuch"], ["ik", "--nosuch"], ["hw", "nosuch"], ["mpc"])


def imported(arguments: list[str]) -> tuple[int, set[str]]:
    """Exit status of a process of its own, and what it imported of all that takes long."""
    code = IMPORTED.format(heavy=sorted(HEAVY))
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False)
    status, *found = done.stderr.splitlines()[-1].split()
    return int(status), set(found)


@pytest.mark.slow
def test_help_of_the_program() -> None:
    assert imported(["--help"]) == (0, set())


@pytest.mark.slow
@pytest.mark.parametrize("arguments", WRONG, ids=" ".join)
def test_wrong_use(arguments: list[str]) -> None:
    assert imported(arguments) == (2, set())


def test_help_of_every_command() -> None:
    """All in one process: each imports no more than the ones before."""
    code = IMPORTED.replace("status = run(sys.argv[1:])", "status = max(run([*name.split(), '--help']) for name in sys.argv[1:])")
    groups = [
        "robot",
        "robot new",
        "robot modes",
        "study",
        "study blind",
        "study machines",
        "study paper",
        "data",
        "data excite",
        "data next",
        "data check",
        "data import",
        "data map",
        "data new",
        "hw",
        "hw check",
        "hw jog",
        "hw monitor",
        "hw estop",
        "hw limits",
        "hw ports",
        "hw calibrate base",
        "hw emulate",
        "hw measure tracker",
        "hw new-tracker",
        "hw trackers",
        "hw calibrate camera",
        "hw rig new",
    ]
    done = subprocess.run(
        [sys.executable, "-c", code.format(heavy=sorted(HEAVY)), *COMMANDS, *groups], capture_output=True, text=True, check=False
    )
    assert done.stderr.splitlines()[-1] == "0"
    assert done.stdout.count("Usage: tepm") == len(COMMANDS) + len(groups)


@pytest.mark.slow
def test_a_working_command_does_import_it() -> None:
    """What the other tests look for would be seen."""
    assert imported(["robot", "show"]) == (0, {"scipy"})


@pytest.mark.parametrize("package", [tepm_opt, plots, studies])
def test_every_name_of_a_package_is_there_and_is_the_one_at_home(package: object) -> None:
    stub = Path(str(package.__file__)).with_suffix(".pyi")  # type: ignore[attr-defined]
    homes = {
        name.name: node.module for node in ast.walk(ast.parse(stub.read_text())) if isinstance(node, ast.ImportFrom) for name in node.names
    }
    assert sorted(homes) == dir(package) == package.__all__  # type: ignore[attr-defined]
    for name, home in homes.items():
        assert getattr(package, name) is getattr(import_module(f".{home}", package.__name__), name)  # type: ignore[attr-defined]
    folder = stub.parent
    assert not {path.stem for path in folder.iterdir()} & homes.keys(), "a module of the same name would take its place"


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="solve_everything"):
        _ = tepm_opt.solve_everything  # type: ignore[attr-defined]


def test_the_package_carries_its_types() -> None:
    assert (Path(tepm_opt.__file__).parent / "py.typed").is_file()


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("module", ["tepm_opt.cli.program", "casadi"])
def test_ctrl_c_while_it_starts(module: str) -> None:
    """An interruption while this module is imported: one line, status 130."""
    code = INTERRUPTED.format(module=module)
    done = subprocess.run([sys.executable, "-c", code, "statics"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "interrupted\n")

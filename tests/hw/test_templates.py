"""Packages written from templates: whole or not at all, and their own tests pass."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from tepm_opt.cli import run
from tepm_opt.errors import InputError
from tepm_opt.hw import trackers
from tepm_opt.hw.templates import Template, write_package
from tests.docs.texts import ROOT

NEEDED = ("", "numpy.linalg", "no_such_module.inside")


@pytest.mark.parametrize("template", ["tracker", "rig"])
def test_a_package_has_its_entry_point_and_no_word_is_left(template: Template, tmp_path: Path) -> None:
    folder = tmp_path / "made"
    files = write_package(template, "my_lab", folder)
    assert {path.as_posix() for path in files} == {"README.md", "pyproject.toml", "tepm_my_lab/__init__.py", "tests/test_my_lab.py"}
    assert not [path for path in files if "@NAME" in (folder / path).read_text() or "@CLASS" in (folder / path).read_text()]
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    assert project["entry-points"] == {f"tepm_opt.{template}s": {"my_lab": "tepm_my_lab:KIND"}}
    assert [path.name for path in tmp_path.iterdir()] == ["made"]


def test_what_is_there_stays(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="exists; name another folder"):
        write_package("rig", "mine", tmp_path)
    with pytest.raises(InputError, match="small letters"):
        write_package("rig", "My Lab", tmp_path / "made")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("template", ["tracker", "rig"])
def test_its_own_tests_pass(template: Template, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a person runs them, without installing the package."""
    monkeypatch.chdir(tmp_path)
    assert run(["hw", f"new-{template}", "my_lab"]) == 0
    folder = tmp_path / "tepm-my_lab"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)])}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests"]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert f"{7 if template == 'tracker' else 4} passed" in done.stdout


def test_the_list_of_trackers(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Each with its description, and whether what it needs is installed."""
    assert run(["hw", "trackers"]) == 0
    assert "openigtlink" in capsys.readouterr().out
    monkeypatch.setattr(
        trackers, "tracker_kinds", lambda: tuple(replace(trackers.find_tracker("openigtlink"), needs=name) for name in NEEDED)
    )
    assert run(["hw", "trackers", "--json"]) == 0
    assert [found["installed"] for found in json.loads(capsys.readouterr().out)] == [True, True, False]

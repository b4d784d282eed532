"""Other ways to the README's two commands: pixi and Docker."""

from __future__ import annotations

import re
import tomllib

from tests.docs.texts import ROOT, steps

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
DEMO, TEST = (step.text for step in steps(ROOT / "README.md") if step.text.startswith("python3 -m venv"))


def test_pixi_has_the_commands_of_the_readme() -> None:
    pixi = tomllib.loads((ROOT / "pixi.toml").read_text(encoding="utf-8"))
    assert pixi["tasks"] == {"demo": DEMO, "test": TEST}
    assert pixi["workspace"]["name"] == PROJECT["name"]
    assert pixi["dependencies"]["python"].startswith(PROJECT["requires-python"])


def test_docker_runs_them_as_nobody_special() -> None:
    """And takes its image from wherever Docker takes images."""
    lines = (ROOT / "Dockerfile").read_text(encoding="utf-8").splitlines()
    assert f"RUN {DEMO}" in lines
    assert lines[-1] == f"CMD {TEST}"
    user = next(k for k, line in enumerate(lines) if line.startswith("USER "))
    assert lines[user] != "USER root"
    assert user < lines.index(f"RUN {DEMO}")
    assert [line for line in lines if line.startswith("FROM")] == ["FROM python:3.12-slim"]


def test_classifiers_are_what_is_supported() -> None:
    """No Python below the least one, and no system that nobody tried."""
    versions = [tuple(map(int, found)) for line in PROJECT["classifiers"] for found in re.findall(r"Python :: (\d+)\.(\d+)$", line)]
    assert min(versions) == tuple(map(int, PROJECT["requires-python"].removeprefix(">=").split(".")))
    assert [line for line in PROJECT["classifiers"] if line.startswith("Operating System")] == ["Operating System :: POSIX :: Linux"]

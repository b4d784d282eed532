"""The command line in-process, in an empty working folder, and one solved circle that many tests read."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from tepm_opt.cli import progress, run
from tepm_opt.jobs import demo, gain
from tepm_opt.jobs.compare import compare
from tepm_opt.jobs.course import Course
from tepm_opt.solvers.linear.gain import WorkspaceMap, workspace_map
from tepm_opt.solvers.planning.trajectories import circle

NO_COMPILER = "no C compiler"  # a warning that is no fault, see models.backends.compiler
PNG = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True)
class Outcome:
    """What a command left behind: exit status, both streams."""

    status: int
    out: str
    err: str

    def json(self) -> Any:
        """The standard output as strict JSON (NaN and Infinity are none)."""

        def refuse(constant: str) -> None:
            raise AssertionError(f"{constant} is not JSON")

        return json.loads(self.out, parse_constant=refuse)


Command = Callable[..., Outcome]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def tepm(here: Path, capsys: pytest.CaptureFixture[str]) -> Command:
    """`tepm ARGUMENTS` in the empty working folder; warnings, which a person would see, count as lines of the error stream."""

    def command(*arguments: object) -> Outcome:
        capsys.readouterr()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("ignore")
            for category in (UserWarning, RuntimeWarning):
                warnings.simplefilter("always", category)
            warnings.filterwarnings("ignore", NO_COMPILER)
            status = run([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return Outcome(status, out, err + "".join(f"warning: {warning.message}\n" for warning in caught))

    return command


@pytest.fixture
def drawn() -> None:
    """Asked for by tests that look at figures; see `_undrawn`."""


@pytest.fixture(autouse=True)
def _undrawn(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are made but not drawn, which is most of a command's time, unless a test asks for `drawn`."""
    if "drawn" not in request.fixturenames:
        monkeypatch.setattr(Figure, "savefig", lambda figure, path, **options: Path(path).write_bytes(PNG))


@pytest.fixture(autouse=True)
def _without_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """What takes long on a busy machine says so; what a command says must not depend on that."""
    monkeypatch.setattr(progress, "EVERY", 3600.0)


def thin_map(patch: pytest.MonkeyPatch) -> None:
    """Six points of the map of the workspace: the middle one of the upper row is in reach."""

    def some(model: Any, across: np.ndarray, height: np.ndarray, **options: Any) -> WorkspaceMap:
        return workspace_map(model, across[:: len(across) // 2], height[[0, 3 * len(height) // 4]], **options)

    patch.setattr(gain, "workspace_map", some)


def small_demo(patch: pytest.MonkeyPatch) -> None:
    """Four points, six of the map, and closed loops over a small part of the circle, in this process."""
    thin_map(patch)
    patch.setattr(demo, "path_for", lambda model, name: circle(4))
    patch.setattr(demo, "COURSE", Course(approach=0.3, pause=0.02, laps=0.02, start_up=0.05))
    patch.setattr(demo, "compare", lambda tasks, workers, progress: compare(tasks, 1, progress))


@pytest.fixture
def coarse_map(monkeypatch: pytest.MonkeyPatch) -> None:
    """See `thin_map`."""
    thin_map(monkeypatch)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """See `small_demo`: for what does not depend on how many there are."""
    small_demo(monkeypatch)


def script(*arguments: object) -> Outcome:
    """The installed program `tepm` in a process of its own."""
    installed = Path(sys.executable).with_name("tepm")
    program = [str(installed)] if installed.exists() else [sys.executable, "-c", "from tepm_opt.cli import main; main()"]
    environment = {**os.environ, "PYTHONWARNINGS": f"ignore:{NO_COMPILER}"}
    done = subprocess.run([*program, *map(str, arguments)], capture_output=True, text=True, check=False, env=environment)
    return Outcome(done.returncode, done.stdout, done.stderr)


def hear_ctrl_c() -> None:
    """For `preexec_fn`: a process that hears SIGINT, also where this one was started in the background and ignores it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.fixture(scope="session")
def solved_circle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of `tepm ik circle` in hybrid mode, then `tepm gain` on its inputs.csv. Read only."""
    folder = tmp_path_factory.mktemp("circle")
    assert run(["ik", "circle", "--out", str(folder)]) == 0
    before = json.loads((folder / "summary.json").read_text())
    assert run(["gain", str(folder / "inputs.csv"), "--out", str(folder)]) == 0
    assert json.loads((folder / "summary.json").read_text())["ik"] == before["ik"], "gain must keep the summary of ik"
    return folder

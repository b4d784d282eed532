"""The page "Any bench in an hour" as a reader follows it, in one folder and in real time."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from pathlib import Path

import pytest

from tests.docs.test_commands import environment, followed
from tests.docs.texts import ROOT, Step, steps

__all__ = ["environment"]  # a fixture
PAGE = ROOT / "docs" / "how-to" / "bench.md"
CAMERA = " --tracker webcam"
ATTEMPTS = 3
"""A machine that does other work beside lets the host fall silent: the board rightly stops then."""


def test_the_page_has_at_most_twelve_steps() -> None:
    numbers = [line.partition(".")[0] for line in PAGE.read_text(encoding="utf-8").splitlines() if line[:1].isdigit()]
    assert numbers == [str(number) for number in range(1, len(numbers) + 1)]
    assert len(numbers) <= 12


def attempted(step: Step, folder: Path, environment: dict[str, str]) -> None:
    """Run a command, and again where the machine was too busy for it."""
    for attempt in range(ATTEMPTS):
        status, out, _ = followed(step, folder, environment)
        if status == 0:
            return
        assert attempt < ATTEMPTS - 1, f"{step.text}\n{out}"


def hurry(environment: dict[str, str]) -> None:
    """Let `tepm` go before other work of the machine, such as tests beside this one, where that is allowed."""
    program = Path(environment["PATH"].partition(":")[0]) / "tepm"
    if os.geteuid() == 0:
        program.write_text(program.read_text().replace("exec ", "exec nice -n -15 "))


@pytest.mark.slow
def test_from_an_empty_folder_to_a_closed_loop(environment: dict[str, str], tmp_path: Path) -> None:
    """All commands but the installation; the tip of the closed loop follows the circle, before other work of the machine."""
    follow_page(environment, tmp_path / "folder", "", "tepm")


@pytest.mark.slow
def test_the_camera_sees_the_arm(environment: dict[str, str], tmp_path: Path) -> None:
    """The first steps with a camera: the board and its tracker are right."""
    pytest.importorskip("cv2", reason="opencv-python-headless is not installed (extra webcam)")
    follow_page(environment, tmp_path / "folder", CAMERA, "tepm hw emulate", "tepm hw check", "tepm hw trackers")


@pytest.mark.study
def test_a_closed_loop_by_camera(environment: dict[str, str], tmp_path: Path) -> None:
    """All steps with a camera, on a machine without other work."""
    pytest.importorskip("cv2", reason="opencv-python-headless is not installed (extra webcam)")
    follow_page(environment, tmp_path / "folder", CAMERA, "tepm")


def follow_page(environment: dict[str, str], folder: Path, tracker: str, *wanted: str) -> None:
    """Run the page's commands that begin as wanted, the bench with a tracker; look at what came out."""
    folder.mkdir()
    hurry(environment)
    bench: subprocess.Popen[str] | None = None
    try:
        for step in steps(PAGE):
            if step.text.endswith(" &"):
                text = f"exec {step.text.removesuffix(' &')}{tracker}"
                bench = subprocess.Popen(["bash", "-c", text], cwd=folder, env=environment, stdout=subprocess.PIPE, text=True)
                assert bench.stdout
                assert "Ctrl-C ends it" in bench.stdout.readline()
            elif step.text == "kill %1":
                assert bench
                bench.send_signal(signal.SIGTERM)
                assert bench.wait(20) == 0
            elif step.text.startswith(wanted):
                attempted(step, folder, environment)
    finally:
        if bench is not None:
            bench.kill()
    if wanted == ("tepm",):
        assert json.loads((folder / "loop" / "summary.json").read_text())["mpc"]["errors"]["tracked"]["rms_m"] < 0.02
    assert not (folder / "bench" / "port").is_symlink()

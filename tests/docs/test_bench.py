"""The page "Any bench in an hour" as a reader follows it, in one folder and in real time."""

from __future__ import annotations

import json
import signal
import subprocess
from pathlib import Path

import pytest

from tests.docs.test_commands import environment, followed
from tests.docs.texts import ROOT, Step, steps

__all__ = ["environment"]  # a fixture
PAGE = ROOT / "docs" / "how-to" / "bench.md"
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


@pytest.mark.slow
def test_from_an_empty_folder_to_a_closed_loop(environment: dict[str, str], tmp_path: Path) -> None:
    """All commands but the installation; the tip of the closed loop follows the circle, however busy the machine."""
    pytest.importorskip("cv2", reason="opencv-python-headless is not installed (extra webcam)")
    folder = tmp_path / "folder"
    folder.mkdir()
    bench: subprocess.Popen[str] | None = None
    done = 0
    try:
        for step in steps(PAGE):
            if step.text.startswith("pip "):
                continue
            if step.text.endswith(" &"):
                text = f"exec {step.text.removesuffix(' &')}"
                bench = subprocess.Popen(["bash", "-c", text], cwd=folder, env=environment, stdout=subprocess.PIPE, text=True)
                assert bench.stdout
                assert "Ctrl-C ends it" in bench.stdout.readline()
            elif step.text == "kill %1":
                assert bench
                bench.send_signal(signal.SIGTERM)
                assert bench.wait(20) == 0
            else:
                attempted(step, folder, environment)
            done += 1
    finally:
        if bench is not None:
            bench.kill()
    assert done >= 8
    assert json.loads((folder / "loop" / "summary.json").read_text())["mpc"]["errors"]["tracked"]["rms_m"] < 0.02
    assert not (folder / "bench" / "port").is_symlink()

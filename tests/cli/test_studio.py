"""`tepm studio`: a page until Ctrl-C, wrong input in one line."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from http.client import HTTPConnection
from pathlib import Path

import pytest

pytest.importorskip("viser", reason="viser is not installed (extra view)")

from tests.cli.conftest import Command
from tests.studio.recorded import write


@pytest.mark.slow
def test_a_page_until_it_is_interrupted(tmp_path: Path) -> None:
    """The address is told, opens once, and Ctrl-C ends the program in order."""
    found = write(tmp_path)
    command = [sys.executable, "-m", "tepm_opt", "studio", str(found), "--no-browser"]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        line = next(line for line in process.stderr if "token" in line)
        address = re.search(r"http://127\.0\.0\.1:(\d+)(/\?token=\S+)", line)
        assert address
        statuses = []
        for path in ("/", address[2], address[2]):
            connection = HTTPConnection("127.0.0.1", int(address[1]), timeout=10)
            connection.request("GET", path)
            statuses.append(connection.getresponse().status)
            connection.close()
        assert statuses == [403, 303, 403]
        process.send_signal(signal.SIGINT)
        out, rest = process.communicate(timeout=30)
    assert process.returncode == 0, rest
    assert out == ""
    assert "closed" in rest
    assert "Traceback" not in rest


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--rig", "serial:/dev/ttyACM0"), "simulated rigs only; valid: sim, sim:FILE"),
        (("--rig", "sim:nosuch"), "neither a file nor built in"),
        (("nosuch.csv",), "nosuch.csv: nothing to look at"),
        (("--robot", "nosuch"), "nosuch"),
        (("--model", "nosuch.toml"), "nosuch.toml"),
        (("--robot", "kang2017", "--model", "m.toml"), "exclude each other"),
        (("--port", "99999"), "--port"),
    ],
)
def test_wrong_input(tepm: Command, here: Path, arguments: tuple[str, ...], message: str) -> None:
    done = tepm("studio", "--no-browser", *arguments)
    assert (done.status, done.out, done.err.count("\n")) == (2, "", 1), done
    assert message in done.err
    assert list(here.iterdir()) == []


def test_viser_is_needed(tepm: Command, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    done = tepm("studio", "--no-browser")
    assert (done.status, done.err.count("\n")) == (2, 1)
    assert "the studio needs viser, which is not installed: pip install 'tepm-opt[view]'" in done.err

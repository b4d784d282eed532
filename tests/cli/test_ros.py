"""`--ros` of `tepm mpc` and `tepm play`, against a stand-in for rosbridge."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.cli import INTERRUPTED
from tests.cli.conftest import Command
from tests.hw.rosbridge import RosbridgeStandIn

pytest.importorskip("websocket")
pytest.importorskip("mujoco")
PATH = ("line", "--from", "0.0,0,0.35", "--to", "0.004,0,0.35", "--duration")


@pytest.fixture
def bridge() -> Iterator[RosbridgeStandIn]:
    """A rosbridge that serves."""
    found = RosbridgeStandIn()
    found.start()
    yield found
    found.stop()


def stop_soon(bridge: RosbridgeStandIn, topic: str) -> threading.Thread:
    """Calls /tepm/stop once ten messages of a topic have come."""

    def run() -> None:
        end = time.monotonic() + 60
        while len(bridge.messages[topic]) < 10 and time.monotonic() < end:
            time.sleep(0.005)
        bridge.call("/tepm/stop")

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    return thread


@pytest.mark.slow
def test_a_closed_loop_is_published_and_stopped(tepm: Command, here: Path, bridge: RosbridgeStandIn) -> None:
    """It ends as with Ctrl-C, and what was done until then is kept."""
    stop_soon(bridge, "/tepm/target")
    done = tepm("mpc", *PATH, 30, "--out", "out", "--ros", f"127.0.0.1:{bridge.port}", "--json")
    told = done.json()
    assert (done.status, told["end"]) == (INTERRUPTED, "interrupted")
    assert 10 <= told["samples"] < 2000
    assert (here / "out" / "log.csv").is_file()
    targets = [message["pose"]["position"] for message in bridge.messages["/tepm/target"]]
    assert targets[0]["z"] == pytest.approx(0.35, abs=0.05)
    assert len(bridge.messages["/joint_states"]) >= 10


@pytest.mark.slow
def test_set_points_played_are_published_and_stopped(tepm: Command, here: Path, bridge: RosbridgeStandIn) -> None:
    """The exit status says that it was interrupted."""
    rows = [
        "time_s,"
        + ",".join(f"pressure_{name}_Pa" for name in (11, 12, 13, 21, 22, 23))
        + ","
        + ",".join(f"tension_{name}_N" for name in (11, 12, 13, 21, 22, 23))
    ]
    rows += [",".join(str(value) for value in [time, *np.full(6, 1e4 * time), *np.zeros(6)]) for time in (0.0, 20.0)]
    Path("inputs.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    stop_soon(bridge, "/tepm/tip")
    done = tepm("play", "inputs.csv", "--ros", f"127.0.0.1:{bridge.port}")
    assert done.status == INTERRUPTED, done.err
    assert bridge.messages["/tepm/pressure_commands"]


def test_nobody_answers(tepm: Command, bridge: RosbridgeStandIn) -> None:
    """It is told before anything moves."""
    bridge.stop()
    done = tepm("mpc", *PATH, 1, "--ros", f"127.0.0.1:{bridge.port}")
    assert done.status == 2
    assert "nobody answers" in " ".join(done.err.split())

"""`tepm record` and `tepm play` as a person meets them: messages, exit status, signals."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.cli import rigs
from tepm_opt.data.datasets import read_dataset
from tepm_opt.data.run import read_run
from tepm_opt.data.setpoints import SetPoints, write_setpoints
from tepm_opt.errors import InputError
from tepm_opt.hw import registry
from tests.cli.conftest import Command, hear_ctrl_c
from tests.data.made import ACTUATORS
from tests.recording.fake_rig import FakeRig, FakeSimulation, write_plan

ROOT = Path(__file__).parents[2]
SLOW = """
import sys
from tepm_opt.cli import main, rigs
from tepm_opt.hw import registry
from tests.recording.fake_rig import FakeRig
rigs.open_rig = lambda text, robot: FakeRig(wait=0.002)
registry.robot_of = lambda text: "kang2017"
main(sys.argv[1:])
"""


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> list[FakeRig]:
    """`--rig` opens a fake one, whatever it says; all that were opened."""
    opened: list[FakeRig] = []

    def open_fake(text: str, robot: object) -> FakeRig:
        opened.append(FakeRig())
        return opened[-1]

    monkeypatch.setattr(rigs, "open_rig", open_fake)
    monkeypatch.setattr(registry, "robot_of", lambda text: "kang2017")
    return opened


@pytest.fixture
def inputs(here: Path) -> Path:
    points = np.tile(np.repeat([1e5, 0.0], 6), (3, 1))
    points[1, 0] = 1.5e5
    write_setpoints(here / "inputs.csv", SetPoints(np.array([0.0, 0.5, 1.0]), points, np.zeros((3, 3))), ACTUATORS)
    return here / "inputs.csv"


class TestRecord:
    @pytest.mark.slow
    def test_for_people(self, tepm: Command, here: Path, fake: list[FakeRig]) -> None:
        write_plan(here)
        done = tepm("record", "plan.toml", "--rig", "fake", "--out", "set")
        assert (done.status, done.out, done.err) == (0, "3 runs recorded in set\n", "")
        done = tepm("record", "plan.toml", "--rig", "fake", "--out", "set")
        assert (done.status, done.out) == (0, "0 runs recorded in set, 3 were there\n")
        assert tepm("data", "check", "set").out == "set: nothing to complain of\n"
        assert len(fake) == 3

    def test_json_and_nothing_else(self, tepm: Command, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        write_plan(here)
        monkeypatch.setattr(rigs, "open_rig", lambda text, robot: FakeSimulation())
        done = tepm("record", "plan.toml", "--rig", "fake", "--out", "set", "--seed", 3, "--json")
        assert (done.status, done.err) == (0, "")
        assert done.json() == {"dataset": "set", "recorded": ["steps.csv", "ramp.csv", "sweep.csv"], "kept": [], "notes": {}}
        assert json.loads((here / "set" / "recording.json").read_text())["seed"] == 3

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (("record", "none.toml", "--out", "set"), "none.toml: cannot be read"),
            (("record", "plan.toml"), "Missing option '--out'"),
            (("record", "plan.toml", "--out", "set", "--rig", "sin"), "unknown rig 'sin': did you mean 'sim'?"),
            (("record", "plan.toml", "--out", "set", "--rig", "sim:none.toml"), "rig 'none.toml' is neither a file nor built in"),
            (("record", "plan.toml", "--out", "set", "--seed", "-1"), "'--seed': Input should be greater than or equal to 0"),
            (("play", "none.csv"), "none.csv: cannot be read"),
            (("play", "plan.toml", "--robot", "none"), "robot 'none' is neither a file nor built in"),
        ],
    )
    def test_wrong_input(self, tepm: Command, here: Path, arguments: tuple[str, ...], message: str) -> None:
        write_plan(here)
        done = tepm(*arguments)
        assert (done.status, done.out, done.err.count("\n")) == (2, "", 1)
        assert message in done.err

    def test_a_rig_that_fails(self, tepm: Command, here: Path, fake: list[FakeRig], monkeypatch: pytest.MonkeyPatch) -> None:
        write_plan(here)
        plain = FakeRig.read

        def read(self: FakeRig):
            if self.ticks == 700:
                raise OSError("the line is dead")
            return plain(self)

        monkeypatch.setattr(FakeRig, "read", read)
        done = tepm("record", "plan.toml", "--rig", "fake", "--out", "set")
        assert (done.status, done.err.count("\n")) == (1, 1)
        assert "the rig failed: the line is dead; 0 of 3 runs are in set, what there is of the next one in set/unfinished" in done.err
        assert fake[0].stops == 1

    def test_a_seed_for_a_rig_without_chance(self, tepm: Command, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        write_plan(here)
        monkeypatch.setattr(rigs, "open_rig", lambda text, robot: FakeRig())
        done = tepm("record", "plan.toml", "--rig", "fake", "--out", "set", "--seed", 3)
        assert (done.status, "--seed 3: rig 'fake' has no noise that can be seeded" in done.err) == (2, True)

    @pytest.mark.slow
    def test_a_recording_that_ends(self, tepm: Command, here: Path, fake: list[FakeRig], monkeypatch: pytest.MonkeyPatch) -> None:
        write_plan(here)
        assert tepm("record", "plan.toml", "--rig", "fake", "--out", "set").status == 0
        monkeypatch.undo()
        monkeypatch.chdir(here)
        done = tepm("record", "plan.toml", "--rig", "replay:set/ramp.csv", "--out", "again")
        assert done.status == 2
        assert "the rig has no more samples" in done.err


class TestPlay:
    def test_for_people(self, tepm: Command, here: Path, fake: list[FakeRig], inputs: Path) -> None:
        done = tepm("play", inputs, "--rig", "fake", "--out", "played")
        assert (done.status, done.out, done.err) == (0, "51 samples in played/measured.csv\n", "")
        assert read_run(here / "played" / "measured.csv").rows == 51
        assert fake[0].stops >= 1
        again = tepm("play", inputs, "--rig", "fake", "--out", "played")
        assert (again.status, "played/measured.csv exists; name another file" in again.err) == (2, True)

    def test_into_a_file(self, tepm: Command, here: Path, fake: list[FakeRig], inputs: Path) -> None:
        assert tepm("play", inputs, "--rig", "fake", "--out", "m.csv").out == "51 samples in m.csv\n"
        assert read_run(here / "m.csv").rows == 51

    def test_no_empty_folder_is_left(self, tepm: Command, here: Path, monkeypatch: pytest.MonkeyPatch, inputs: Path) -> None:
        def failing(text: str, robot: object) -> FakeRig:
            raise InputError("no rig there")

        monkeypatch.setattr(rigs, "open_rig", failing)
        assert tepm("play", inputs, "--rig", "fake", "--out", "played").status == 2
        assert not (here / "played").exists()

    def test_json(self, tepm: Command, fake: list[FakeRig], inputs: Path) -> None:
        done = tepm("play", inputs, "--rig", "fake", "--rate", 100, "--json")
        assert done.json() == {"file": "played/measured.csv", "rows": 101, "duration_s": 1.0, "notes": []}

    def test_on_the_simulated_rig(self, tepm: Command, here: Path, inputs: Path) -> None:
        pytest.importorskip("mujoco")
        done = tepm("play", inputs, "--rig", "sim:perfect", "--out", "m.csv")
        assert (done.status, done.err) == (0, "")
        run = read_run(here / "m.csv")
        np.testing.assert_allclose(run.inputs[[0, 25, 50], 0], [1e5, 1.5e5, 1e5])


@pytest.mark.skipif(sys.platform == "win32", reason="signals of other systems")
class TestSignals:
    def begin(self, here: Path, *arguments: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-c", SLOW, *arguments],
            cwd=here,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=hear_ctrl_c,
        )

    def wait_for(self, folder: Path, pattern: str, process: subprocess.Popen[str]) -> None:
        end = time.monotonic() + 60
        while not any(path.stat().st_size > 20000 for path in folder.glob(pattern)):
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < end
            time.sleep(0.01)

    @pytest.mark.slow
    def test_record(self, tepm: Command, here: Path, fake: list[FakeRig]) -> None:
        write_plan(here)
        process = self.begin(here, "record", "plan.toml", "--out", "set", "--rig", "fake")
        self.wait_for(here, "set/unfinished/*.csv", process)
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=60)
        assert (process.returncode, out) == (130, "")
        assert "interrupted: 0 of 3 runs are in set, what there is of the next one in set/unfinished; the same command goes on" in err
        assert read_dataset(here / "set").runs == ()
        journal = read_run(here / "set" / "unfinished" / "steps-1.unfinished.csv")
        assert tepm("record", "plan.toml", "--out", "set", "--rig", "fake").status == 0
        np.testing.assert_array_equal(read_dataset(here / "set").runs[0].points[: journal.rows], journal.points)

    @pytest.mark.slow
    def test_play(self, here: Path, inputs: Path) -> None:
        process = self.begin(here, "play", "inputs.csv", "--rig", "fake", "--out", "played")
        self.wait_for(here, "played/measured-1.unfinished.csv", process)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
        assert process.returncode == 130
        assert "the rig is stopped; what was measured is in played/measured-….unfinished.csv" in err
        assert not (here / "played" / "measured.csv").exists()

"""`tepm hw rig new|show|check`, and rigs of other robots in other commands."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tepm_opt.hw.simulation.rigfile import load_rig_file
from tests.cli.conftest import Command

CLAMPED = "[imperfections.rigid_plates]\n# clamped_length_m"


def test_new_check_and_show(tepm: Command, here: Path) -> None:
    """A rig file for a robot of one's own, in another folder: its robot is named as seen from there."""
    (here / "rigs").mkdir()
    assert tepm("robot", "new", "lab.toml", "--from", "one_module").status == 0
    done = tepm("hw", "rig", "new", "rigs/bench.toml", "--robot", "lab.toml")
    assert (done.status, done.err) == (0, "")
    assert 'robot = "../lab.toml"' in (here / "rigs" / "bench.toml").read_text(encoding="utf-8")
    assert load_rig_file(here / "rigs" / "bench.toml").nominal.name == "lab"
    again = tepm("hw", "rig", "new", "rigs/bench.toml")
    assert (again.status, again.err) == (2, "error: rigs/bench.toml exists; name another file\n")
    told = json.loads(tepm("hw", "rig", "show", "rigs/bench.toml", "--json").out)
    assert (told["name"], told["robot"], told["imperfections"]["regulator_lag"]["fill_s"]) == ("bench", "lab", 0.06)
    checked = json.loads(tepm("hw", "rig", "check", "rigs/bench.toml", "--json").out)
    assert checked["step_s"] <= checked["longest_step_s"] < 2.5e-4
    assert "payload" not in checked["imperfections"]


def test_what_is_wrong_is_one_line(tepm: Command, here: Path) -> None:
    tepm("hw", "rig", "new", "rig.toml", "--from", "perfect")
    text = (here / "rig.toml").read_text(encoding="utf-8")
    for old, new, says in (
        ("latency_s = 0.0 ", "latency_s = 15.0", "tracker: latency_s = 15.0: input should be less than or equal to 1; valid: 0 … 1 s"),
        (f"# {CLAMPED} = 0.0", f"{CLAMPED.replace('# ', '')} = 0.1", "leaves nothing of a segment"),
        ('robot = "kang2017"', 'robot = "kang"', "robot 'kang' is neither a file nor built in"),
        ("[simulation]", "[simulations]", "unknown key 'simulations': did you mean 'simulation'?"),
    ):
        assert old in text
        (here / "rig.toml").write_text(text.replace(old, new, 1), encoding="utf-8")
        done = tepm("hw", "rig", "check", "rig.toml")
        assert (done.status, done.err.count("\n")) == (2, 1)
        assert says in done.err
    for arguments, says in (
        (("hw", "rig", "new", "other.toml", "--from", "perfekt"), "--from perfekt: no built-in rig; valid: perfect, virtual_prototype"),
        (("hw", "rig", "check", "rig.toml", "--robot", "slim"), "rig rig.toml names its robot itself"),
        (("record", "plan.toml", "--robot", "slim", "--out", "set"), "plan.toml names its robot itself; leave the option out"),
    ):
        done = tepm(*arguments)
        assert (done.status, done.err.count("\n")) == (2, 1)
        assert says in done.err


@pytest.mark.slow
def test_a_robot_that_is_not_the_papers_is_played_and_followed(tepm: Command, here: Path) -> None:
    """Set points of one module on `--rig sim`, and from a rig file whose robot nobody has to name again."""
    names = ["time_s", *(f"pressure_1{k}_Pa" for k in (1, 2, 3)), *(f"tension_1{k}_N" for k in (1, 2, 3))]
    rows = ["0,0,0,0,0,0,0", "0.5,20000,0,0,0,0,0"]
    (here / "inputs.csv").write_text("\n".join([",".join(names), *rows]) + "\n", encoding="utf-8")
    done = tepm("play", "inputs.csv", "--robot", "one_module", "--rig", "sim@mujoco", "--out", "a.csv")
    assert (done.status, done.err) == (0, "")
    assert tepm("hw", "rig", "new", "rig.toml", "--robot", "one_module").status == 0
    done = tepm("play", "inputs.csv", "--rig", "sim:rig.toml@mujoco", "--out", "b.csv", "--json")
    assert json.loads(done.out)["rows"] == 26
    refused = tepm("play", "inputs.csv", "--robot", "slim", "--rig", "sim:rig.toml", "--out", "c.csv")
    assert refused.status == 2

"""`tepm export`: files of every kind, what is left out, what is wrong."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import mujoco
import pytest

from tepm_opt.models.effects import effects
from tepm_opt.models.model import Model, write_model
from tests.cli.conftest import Command
from tests.cli.tables import names_in


def test_files_of_a_model(tepm: Command, here: Path) -> None:
    """Others' programs open them."""
    for kind in ("c", "casadi", "mjcf"):
        done = tepm("export", kind, "--out", kind)
        assert (done.status, done.err) == (0, "")
    assert "#define ROBOT_INPUTS 12" in (here / "c" / "robot_sizes.h").read_text(encoding="utf-8")
    assert ca.Function.load(str(here / "casadi" / "statics.casadi")).name_in() == ["x0", "u", "force"]
    assert mujoco.MjModel.from_xml_path(str(here / "mjcf" / "robot.xml")).nu == 12


@pytest.mark.slow
def test_effects_that_are_left_out_are_told(tepm: Command, here: Path) -> None:
    late = next(effect for effect in effects() if effect.has("delay") and not effect.timed)
    write_model(Model.from_robot("kang2017").with_effect(late.name), here / "m.toml")
    done = tepm("export", "mjcf", "--model", "m.toml", "--json")
    assert done.status == 0
    assert done.err == f"without {late.name}: commands that act late\n"
    assert done.json() == {"files": ["robot_mjcf/robot.xml"], "without": {late.name: "commands that act late"}}


def test_a_log(tepm: Command, here: Path) -> None:
    pytest.importorskip("mcap", reason="mcap is not installed (extra mcap)")
    (here / "log.csv").write_text("time_s,a\n0,1\n1,\n", encoding="utf-8")
    done = tepm("export", "mcap", "log.csv")
    assert (done.status, done.err) == (0, "")
    assert names_in(here / "mcap") == {"log.mcap"}


@pytest.mark.slow
def test_the_controller(tepm: Command, here: Path, compiler: None) -> None:
    done = tepm("export", "controller", "circle", "--points", "20", "--duration", "2", "--out", "ctl")
    assert (done.status, done.err) == (0, "")
    assert {"controller.h", "CMakeLists.txt"} < names_in(here / "ctl")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("c", "--robot", "nobody"), "nobody"),
        (("casadi", "--out", "file"), "output folder file is a file"),
        (("mcap", "nowhere.csv"), "nowhere.csv: cannot be read"),
        (("controller", "square"), "unknown trajectory 'square'"),
    ],
)
def test_wrong_input_is_one_line(tepm: Command, here: Path, arguments: tuple[str, ...], says: str) -> None:
    (here / "file").write_text("", encoding="utf-8")
    done = tepm("export", *arguments)
    assert done.status == 2
    assert says in done.err
    assert len(done.err.splitlines()) == 1
    assert names_in(here) == {"file"}

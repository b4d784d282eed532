"""What a person gets wrong: one line that names it, exit status 2, nothing on the standard output, nothing half-written."""

from __future__ import annotations

import os
import shlex
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from tepm_opt.models import effects
from tepm_opt.models.effect import Effect, Parameter
from tepm_opt.models.robot import robot_text
from tests.cli.conftest import Command, Outcome, script
from tests.cli.tables import input_columns

TARGETS = "x,y,z\n0.10,0.00,0.35\n0.11,0.00,0.36\n0.12,0.00,0.35\n"
TIMED = "time_s,x,y,z\n0,0.10,0.00,0.35\n1,0.11,0.00,0.36\n2,0.12,0.00,0.35\n"
HEADER = ",".join(input_columns())
ROWS = ("0,2e5,2e5,2e5,2e5,2e5,2e5,1,1,1,1,1,1", "1,2e5,2e5,2e5,2e5,2e5,2e5,2,2,2,2,2,2")
INPUTS = "\n".join((HEADER, *ROWS, ""))
ROBOT = robot_text("kang2017")
PAYLOAD = 'robot = "kang2017"\n\n[[effects]]\nname = "payload"\nparameters = {mass = 0.01}\n'


def edited(text: str, old: str, new: str) -> str:
    """The text with its first `old` replaced, which must be there."""
    assert old in text
    return text.replace(old, new, 1)


def second(text: str, old: str, new: str) -> str:
    """The text with `old` replaced in its last line."""
    *lines, last = text.rstrip("\n").split("\n")
    return "\n".join([*lines, edited(last, old, new), ""])


@dataclass(frozen=True)
class Case:
    """A wrong command.

    Attributes:
        name: of the test.
        command: after `tepm`, in a folder with these files.
        says: what the message must contain: the offending name, value, file or line.
        files: by name.
    """

    name: str
    command: str
    says: tuple[str, ...]
    files: Mapping[str, str | bytes] = field(default_factory=dict)


def target_file(name: str, text: str | bytes, *says: str) -> Case:
    """`tepm ik t.csv` with a wrong file of targets."""
    return Case(f"targets-{name}", "ik t.csv --out out", ("t.csv", *says), {"t.csv": text})


def input_file(name: str, text: str | bytes, *says: str, command: str = "gain") -> Case:
    """`tepm gain in.csv` with a wrong set-point file."""
    return Case(f"inputs-{name}", f"{command} in.csv --out out", ("in.csv", *says), {"in.csv": text})


def robot_file(name: str, old: str, new: str, *says: str) -> Case:
    """A command with a wrong robot file."""
    return Case(f"robot-{name}", "ik circle --robot r.toml --out out", ("r.toml", *says), {"r.toml": edited(ROBOT, old, new)})


def model_file(name: str, text: str | bytes, *says: str) -> Case:
    """A command with a wrong model file."""
    return Case(f"model-{name}", "ik circle --model m.toml --out out", says, {"m.toml": text})


FILES = [
    target_file("missing column", edited(TARGETS, "x,y,z", "x,y,w"), "'z'", "x, y, w"),
    target_file("text in a number", edited(TARGETS, "0.11", "abc"), "line 3", "x", "'abc'"),
    target_file("NaN", edited(TARGETS, "0.36", "nan"), "line 3", "z"),
    target_file("empty field", edited(TARGETS, "0.11", ""), "line 3", "x"),
    target_file("inf", edited(TARGETS, "0.12", "-inf"), "line 4", "x", "inf"),
    target_file("overflow", edited(TARGETS, "0.12", "1e999"), "line 4", "x", "inf"),
    target_file("millimetres", edited(TARGETS, "0.11,0.00,0.36", "110,0,360"), "line 3", "x", "110", "m"),
    target_file("ragged row", edited(TARGETS, "0.11,0.00,0.36", "0.11,0.00"), "line 3", "2", "3"),
    target_file("too many fields", edited(TARGETS, "0.36", "0.36,1"), "line 3", "4", "3"),
    target_file("duplicate column", edited(TARGETS, "x,y,z", "x,y,x"), "line 1", "'x'"),
    target_file("semicolons", TARGETS.replace(",", ";"), "line 1", "';'", "','"),
    target_file("empty file", "", "empty"),
    target_file("blank lines only", "\n\n\n", "empty"),
    target_file("header only", "x,y,z\n", "no rows"),
    target_file("binary", b"\x89PNG\r\n\x1a\n\xff\xfe\x00", "text"),
    target_file("null bytes", b"x,y,z\n\x00,0,0.35\n", "line 2"),
    target_file("time not increasing", edited(TIMED, "2,0.12", "1,0.12"), "line 4", "time_s", "1"),
    target_file("time going back", edited(TIMED, "2,0.12", "0.5,0.12"), "line 4", "time_s", "0.5"),
    target_file("time missing", edited(TIMED, "\n1,", "\n,"), "line 3", "time_s"),
    Case("targets-absent", "ik absent.csv --out out", ("absent.csv", "No such file")),
    Case("targets-folder", "ik folder.csv --out out", ("folder.csv", "directory"), {"folder.csv/inside": ""}),
    input_file("missing column", INPUTS.replace("tension_23_N", "strain_23_N"), "'tension_23_N'"),
    input_file("no such actuator", INPUTS.replace("tension_23_N", "tension_24_N"), "'tension_24_N'", "21, 22, 23"),
    input_file("no time", INPUTS.replace("time_s", "time"), "'time_s'"),
    input_file("pressure above range", second(INPUTS, "2e5", "500100"), "line 3", "pressure_11_Pa", "500100", "500000"),
    input_file("pressure in bar", second(INPUTS, "2e5", "-2"), "line 3", "pressure_11_Pa", "-2"),
    input_file("negative tension", second(INPUTS, ",2,", ",-0.5,"), "line 3", "tension_11_N", "-0.5", "7"),
    input_file("tension above range", second(INPUTS, ",2,", ",7.1,"), "line 3", "tension_11_N", "7.1"),
    input_file("text in a number", second(INPUTS, ",2,", ",2 N,"), "line 3", "tension_11_N", "'2 N'"),
    input_file("NaN", second(INPUTS, ",2,", ",nan,"), "line 3", "tension_11_N"),
    input_file("empty field", second(INPUTS, ",2,", ",,"), "line 3", "tension_11_N"),
    input_file("time not increasing", INPUTS.replace("\n1,", "\n0,"), "line 3", "time_s"),
    input_file("tip force", edited(INPUTS, HEADER, f"{HEADER},tip_force_x_N").replace(",1\n", ",1,a\n").replace(",2\n", ",2,b\n"), "'a'"),
    input_file("pressure above range in statics", second(INPUTS, "2e5", "6e5"), "line 3", "pressure_11_Pa", "600000", command="statics"),
    input_file("of another robot", INPUTS.replace("_23_", "_33_"), "'pressure_33_Pa'", "21, 22, 23", command="statics"),
    Case("inputs-absent", "gain absent.csv --out out", ("absent.csv",)),
    Case("inputs-folder", "statics folder --out out", ("folder", "directory"), {"folder/inside": ""}),
]

OPTIONS = [
    Case("unknown trajectory", "ik spiral --out out", ("'spiral'", "circle", "lissajous", ".csv")),
    Case("0 points", "ik circle --points 0 --out out", ("points", "0")),
    Case("negative points", "ik line --points -3 --out out", ("points", "-3")),
    Case("points of a file", "ik t.csv --points 0 --out out", ("points", "0"), {"t.csv": TARGETS}),
    Case("resampling one point", "ik t.csv --points 5 --out out", ("1 point", "5"), {"t.csv": "x,y,z\n0.1,0,0.35\n"}),
    Case("half a point", "ik circle --points 1.5 --out out", ("--points",)),
    Case("zero duration", "ik circle --duration 0 --out out", ("--duration", "0")),
    Case("negative duration", "ik t.csv --duration -2 --out out", ("--duration", "-2"), {"t.csv": TARGETS}),
    Case("NaN duration", "ik circle --duration nan --out out", ("--duration", "nan")),
    Case("infinite duration", "ik circle --duration inf --out out", ("--duration", "inf")),
    Case("NaN radius", "ik circle --radius nan --out out", ("radius", "nan")),
    Case("infinite radius", "ik circle --radius inf --out out", ("radius", "inf")),
    Case("NaN height", "ik lissajous --height nan --out out", ("height", "nan")),
    Case("start of a circle", "ik circle --from 0,0,0.3 --out out", ("--from", "circle")),
    Case("radius of a line", "ik line --radius 0.1 --out out", ("radius", "line")),
    Case("height of a file", "ik t.csv --height 0.1 --out out", ("height", "t.csv"), {"t.csv": TARGETS}),
    Case("vector of two", "ik line --from 0.1,0.35 --out out", ("--from", "0.1,0.35", "3")),
    Case("vector of text", "ik line --to a,b,c --out out", ("--to", "a,b,c")),
    Case("vector with NaN", "ik line --to nan,0,0.3 --out out", ("--to", "nan")),
    Case("empty vector", "ik line --to '' --out out", ("--to",)),
    Case("tip force of two", "ik circle --tip-force 1,2 --out out", ("--tip-force", "1,2")),
    Case("infinite tip force", "statics --tip-force inf,0,0 --out out", ("--tip-force", "inf")),
    Case("wrong number of pressures", "statics --pressures 1e5,1e5,1e5 --out out", ("--pressures", "6")),
    Case("wrong number of tensions", "statics --tensions 1,1,1,1,1,1,1 --out out", ("--tensions", "6")),
    Case("pressure above range", "statics --pressures 0,0,0,0,6e5,0 --out out", ("pressure_22", "600000", "500000")),
    Case("negative tension", "statics --tensions=-1,0,0,0,0,0 --out out", ("tension_11", "-1")),
    Case("file and pressures", "statics in.csv --pressures 0,0,0,0,0,0 --out out", ("--pressures", "file"), {"in.csv": INPUTS}),
    Case("file and tip force", "statics in.csv --tip-force 1,0,0 --out out", ("--tip-force", "file"), {"in.csv": INPUTS}),
    Case("mode", "ik circle --mode fast --out out", ("--mode", "fast", "pressure", "hybrid")),
    Case("mid-tension above range", "ik circle --mid-tension 7.5 --out out", ("--mid-tension", "7.5", "7")),
    Case("mid-tension below range", "ik circle --mid-tension -1 --out out", ("--mid-tension", "-1")),
    Case("mid-tension NaN", "ik circle --mid-tension nan --out out", ("--mid-tension", "nan")),
    Case("reference point", "gain in.csv --point s9 --out out", ("'s9'", "s1", "s4"), {"in.csv": INPUTS}),
    Case("unknown option", "ik circle --speed 3 --out out", ("--speed",)),
    Case("no such command", "solve circle", ("'solve'",)),
    Case("no such robot command", "robot make x.toml", ("'make'",)),
    Case("missing argument", "ik --out out", ("TRAJECTORY",)),
    Case("argument too many", "ik circle line --out out", ("line",)),
    Case("option without value", "ik circle --points", ("--points",)),
]

FOLDERS = [
    Case("output folder is a file", "ik circle --out taken", ("taken", "file"), {"taken": "kept"}),
    Case("output folder below a file", "ik circle --out taken/below", ("taken/below",), {"taken": "kept"}),
    Case("output folder below a file in gain", "gain in.csv --out taken/below", ("taken/below",), {"taken": "kept", "in.csv": INPUTS}),
    Case("output folder below a file in statics", "statics --out taken/below", ("taken/below",), {"taken": "kept"}),
    Case("output folder below a file in demo", "demo --out taken/below", ("taken/below",), {"taken": "kept"}),
    Case("output folder in /proc", "ik circle --out /proc/tepm", ("/proc/tepm",)),
    Case("new robot on a file", "robot new taken.toml", ("taken.toml", "exists"), {"taken.toml": "kept"}),
    Case("new robot in no folder", "robot new absent/r.toml", ("absent/r.toml",)),
    Case("new robot in /proc", "robot new /proc/r.toml", ("/proc/r.toml",)),
    Case("new robot from nothing", "robot new r.toml --from kang2018", ("'kang2018'", "kang2017")),
    Case("square brackets in a name", "ik 'a[b].csv' --out out", ("a[b].csv",)),
    Case("closing tag in a name", "ik 'a[/b].csv' --out out", ("a[/b].csv",)),
]

ROBOTS = [
    Case("unknown robot", "ik circle --robot kang2018 --out out", ("'kang2018'", "kang2017")),
    Case("unknown robot of statics", "statics --robot absent.toml --out out", ("'absent.toml'",)),
    Case("robot and model", "ik circle --robot kang2017 --model m.toml --out out", ("--robot", "--model"), {"m.toml": PAYLOAD}),
    Case("check an unknown robot", "robot check nobody", ("'nobody'",)),
    Case("show an unknown robot", "robot show nobody", ("'nobody'",)),
    Case("binary robot file", "robot check r.toml", ("r.toml", "text"), {"r.toml": b"\xff\xfe\x00"}),
    robot_file("unknown key", "modules = 2", "modules = 2\nmodulse = 3", "modulse", "segments_per_module"),
    robot_file("unknown table", "[tracker]", "[trackers]\nrate_hz = 100\n\n[tracker]", "trackers", "tracker"),
    robot_file("missing key", "K_a = 358.86", "", "K_a"),
    robot_file("missing table", ROBOT[ROBOT.index("[tracker]") :], "", "tracker"),
    robot_file("full scale of 0.5 Pa", "full_scale_Pa = 0.9e6", "full_scale_Pa = 0.5", "pressure_full_scale_Pa", "0.5", "1000", "Pa"),
    robot_file("length in mm", "L_0 = 0.200", "L_0 = 200", "L_0", "200", "m"),
    robot_file("mass in g", "m_d = 0.22", "m_d = 220", "m_d", "220", "kg"),
    robot_file("negative stiffness", "K_a = 358.86", "K_a = -358.86", "K_a", "-358.86"),
    robot_file("zero stiffness ratio", "alpha_1 = 70", "alpha_1 = 0", "alpha_1", "0"),
    robot_file("NaN", "r = 0.040", "r = nan", "r = nan"),
    robot_file("number as text", "modules = 2", 'modules = "2"', "modules", "'2'"),
    robot_file("no modules", "modules = 2", "modules = 0", "modules", "0", "1"),
    robot_file("two actuators", "[90, 210, 330]", "[90, 270]", "actuator_angles_deg", "3"),
    robot_file("actuators on one spot", "[90, 210, 330]", "[90, 90, 330]", "actuator_angles_deg", "same angle"),
    robot_file("range above full scale", "max_Pa = 0.5e6", "max_Pa = 2e6", "pressure_max_Pa", "2e+06", "pressure_full_scale_Pa"),
    robot_file("bracing", '"crossed"', '"double"', "bracing", "'double'", "crossed", "single"),
    robot_file("gravity in cm/s^2", "-9.81]", "-981]", "gravity_m_per_s2", "981"),
    robot_file("vector of two", "[0, 0, -9.81]", "[0, -9.81]", "gravity_m_per_s2"),
    robot_file("prior of nothing", "[priors]", "[priors]\nK_b = 0.1", "'K_b'", "K_a"),
    robot_file("not TOML", "modules = 2", "modules = = 2", "TOML", "line 6"),
    model_file("unknown effect", edited(PAYLOAD, '"payload"', '"payloads"'), "m.toml", "'payloads'", "'payload'", "pressure_dead_zone"),
    model_file("unknown effect parameter", edited(PAYLOAD, "mass =", "weight ="), "m.toml", "'weight'", "mass"),
    model_file("missing effect parameter", edited(PAYLOAD, "{mass = 0.01}", "{}"), "m.toml", "payload", "mass"),
    model_file("effect parameter out of range", edited(PAYLOAD, "0.01", "-0.01"), "m.toml", "payload", "mass", "-0.01", "kg"),
    model_file("effect parameter as text", edited(PAYLOAD, "0.01", '"10 g"'), "m.toml", "payload", "mass", "'10 g'"),
    model_file("effect parameter true", edited(PAYLOAD, "0.01", "true"), "m.toml", "payload", "mass", "True"),
    model_file("detail of an effect without", edited(PAYLOAD, "[[effects]]", '[[effects]]\ndetail = "s4"'), "m.toml", "payload", "'s4'"),
    model_file("effect without name", edited(PAYLOAD, 'name = "payload"', ""), "m.toml", "name"),
    model_file("unknown key of an effect", edited(PAYLOAD, "[[effects]]", '[[effects]]\nactuator = "23"'), "m.toml", "actuator", "detail"),
    model_file("unknown key", edited(PAYLOAD, "\n\n", '\nrobots = "x"\n'), "m.toml", "robots", "robot"),
    model_file("unknown robot parameter", f"{PAYLOAD}[parameters]\nK_b = 300\n", "m.toml", "'K_b'", "'K_a'"),
    model_file("robot parameter out of range", f"{PAYLOAD}[parameters]\nK_a = -3\n", "m.toml", "K_a", "-3"),
    model_file("unknown robot", edited(PAYLOAD, '"kang2017"', '"kang2018"'), "kang2018"),
    model_file("no robot", edited(PAYLOAD, 'robot = "kang2017"', ""), "m.toml", "'robot'"),
    model_file("effect twice", PAYLOAD + PAYLOAD[PAYLOAD.index("[[") :], "payload", "twice"),
    model_file("not TOML", "robot: kang2017\n", "m.toml", "TOML", "line 1"),
    model_file("empty", "", "m.toml", "'robot'"),
    Case("model-absent", "statics --model absent.toml --out out", ("absent.toml",)),
    Case("model-folder", "statics --model folder --out out", ("folder", "directory"), {"folder/inside": ""}),
]

CASES = [*FILES, *OPTIONS, *FOLDERS, *ROBOTS]


def write(files: Mapping[str, str | bytes]) -> None:
    for name, content in files.items():
        path = Path(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, hidden ones too; folders that hold nothing do not count."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def check(outcome: Outcome, says: tuple[str, ...]) -> None:
    """One line beginning "error:" with all of `says`, exit status 2, nothing on the standard output."""
    assert outcome.status == 2
    assert outcome.out == ""
    (line,) = outcome.err.splitlines()
    assert line.startswith("error:")
    assert "Traceback" not in line
    missing = [fragment for fragment in says if fragment not in line]
    assert not missing, line


def parameters() -> list[Any]:
    return [pytest.param(case, id=case.name.replace(" ", "-")) for case in CASES]


@pytest.mark.sample(3)
@pytest.mark.parametrize("case", parameters())
def test_wrong_input_is_one_clear_line(tepm: Command, here: Path, case: Case) -> None:
    write(case.files)
    before = contents(here)
    check(tepm(*shlex.split(case.command)), case.says)
    assert contents(here) == before


def test_no_case_twice() -> None:
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names) >= 35


class Probe(Effect):
    """An effect with a detail."""

    name, explains, reference, detail = "probe", "nothing", "none", "actuator"
    parameters = (Parameter("size", "-", null=0.0, probe=1.0),)


@pytest.mark.parametrize(("detail", "says"), [('detail = "33"\n', "'33'"), ("", "detail"), ('detail = "s1"\n', "'s1'")])
def test_unknown_detail_of_an_effect(tepm: Command, monkeypatch: pytest.MonkeyPatch, detail: str, says: str) -> None:
    monkeypatch.setitem(effects._registry(), "probe", Probe())
    write({"m.toml": f'robot = "kang2017"\n[[effects]]\nname = "probe"\n{detail}parameters = {{size = 1.0}}\n'})
    check(tepm("statics", "--model", "m.toml", "--out", "out"), ("m.toml", "probe", says, "11", "23"))


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_read_only_output_folder(tepm: Command, here: Path) -> None:
    (here / "locked").mkdir(mode=0o555)
    check(tepm("ik", "circle", "--out", "locked"), ("locked",))
    check(tepm("ik", "circle", "--out", "locked/below"), ("locked/below",))


def test_a_file_that_cannot_be_replaced_leaves_no_temporary_one(tepm: Command, here: Path) -> None:
    (here / "out" / "inputs.csv").mkdir(parents=True)
    check(tepm("ik", "circle", "--points", 2, "--out", "out"), ("out/inputs.csv",))
    assert contents(here) == {}


@pytest.mark.slow
def test_wrong_input_leaves_earlier_results_alone(tepm: Command, here: Path, solved_circle: Path) -> None:
    shutil.copytree(solved_circle, here / "out")
    before = contents(here)
    for command in ("ik circle --points 0", "ik circle --mid-tension 9", "gain absent.csv", "statics --tensions 9,0,0,0,0,0"):
        check(tepm(*shlex.split(command), "--out", "out"), ())
        assert contents(here) == before


@pytest.mark.slow
def test_json_does_not_change_how_errors_are_told(tepm: Command) -> None:
    for command in ("ik spiral --json", "gain absent.csv --json", "statics --tensions 1 --json", "robot check nobody --json"):
        check(tepm(*shlex.split(command)), ())


@pytest.mark.slow
@pytest.mark.parametrize("command", ["ik spiral", "ik circle --robot kang2018", "statics --pressures 1"])
def test_wrong_input_of_the_installed_script(here: Path, command: str) -> None:
    check(script(*shlex.split(command)), (command.split()[-1],))
    assert contents(here) == {}

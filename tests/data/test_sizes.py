"""Values in another unit, and files of other programs: one judgement and one set of words for options, set points and data."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tepm_opt.data.documents import read_toml
from tepm_opt.data.foreign import kind_of
from tepm_opt.data.setpoints import input_columns, read_setpoints
from tepm_opt.data.sizes import PRESSURE, TENSION, judge_force, judge_inputs, judge_places, refuse_millimetres
from tepm_opt.data.tables import read_table
from tepm_opt.errors import InputError
from tepm_opt.models.robot import load_robot
from tests.paths import SHARED

LIMITS = np.array([5e5] * 2 + [7.0] * 2)
ROBOTS = SHARED / "cases" / "13-robot-files"


@given(st.floats(0.05, 1.0), st.sampled_from(["kPa", "bar", "MPa"]))
def test_pressures_in_another_unit_are_told(part: float, unit: str) -> None:
    given = part * 5e5 / PRESSURE.others[unit]
    told = judge_inputs(np.array([[given, 0.0, 1.0, 0.0]]), LIMITS)
    assert told.startswith(f"pressures reach {given:g}; valid: 0 … 500000 Pa: in ")
    assert judge_inputs(np.array([[part * 5e5, 0.0, 1.0, 0.0]]), LIMITS) == ""


@given(st.floats(0.0, 1e-3))
def test_rounding_is_no_unit(tiny: float) -> None:
    assert judge_inputs(np.array([[1e5, 0.0, 1e-5 * tiny, 0.0]]), LIMITS) == ""


def test_tensions_and_forces() -> None:
    assert TENSION.judge(3000.0, 7.0) == "tensions reach 3000; valid: 0 … 7 N: in mN?"
    assert "in g or mN?" in judge_force(250.0, 42.0)
    assert judge_force(2.5, 42.0) == ""


@given(st.floats(-300, 300), st.floats(-300, 300), st.floats(100, 450))
def test_places_in_millimetres(x: float, y: float, z: float) -> None:
    place, base = np.array([x, y, z]), (0.0, 0.0, -0.05)
    assert judge_places(place / 1e3, base, 0.4) == ""
    assert "times what the robot's size allows: in " in judge_places(place, base, 0.4)
    with pytest.raises(InputError, match=r"= .*; valid: metres within 50 m, not millimetres"):
        refuse_millimetres(place, "--from")


def test_set_points_in_another_unit(tmp_path: Path) -> None:
    path = tmp_path / "inputs.csv"
    names = ["time_s", *input_columns(["11", "12"])]
    path.write_text(",".join(names) + "\n0,0,0,0,0\n1,200,300,1,1\n", encoding="utf-8")
    with pytest.raises(InputError, match="pressures reach 300; valid: 0 … 500000 Pa: in kPa"):
        read_setpoints(path, ["11", "12"], LIMITS)


FOREIGN = {
    "MJCF": (b'<mujoco model="arm">\n</mujoco>', "an MJCF model of MuJoCo"),
    "URDF": (b'\xef\xbb\xbf<?xml version="1.0"?>\n<!-- <mujoco> -->\n<robot name="arm"/>', "a URDF model"),
    "XML": (b"<settings/>", "an XML file"),
    "xlsx": (b"PK\x03\x04\x14\x00[Content_Types].xml\xff\xfe", "an Excel workbook"),
    "xls": (b"\xd0\xcf\x11\xe0\xa1\xb1", "an Excel workbook"),
    "JSON": (b'{\n  "name": "arm"\n}', "a JSON file"),
    "HDF5": (b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
}


@pytest.mark.parametrize(("content", "kind"), FOREIGN.values(), ids=FOREIGN)
def test_foreign_files_are_named_with_a_way(tmp_path: Path, content: bytes, kind: str) -> None:
    path = tmp_path / "theirs"
    path.write_bytes(content)
    for read, way in ((load_robot, "tepm robot new mine.toml"), (read_table, "save it as CSV"), (read_toml, "tepm reads TOML")):
        with pytest.raises(InputError, match=kind) as raised:
            read(path)  # type: ignore[operator]
        assert way in str(raised.value)
        assert "\n" not in str(raised.value)


@given(st.text(max_size=200))
def test_ours_are_not_foreign(text: str) -> None:
    for ours in (f"time_s,x,y,z\n{text}", f"[table]\n# {text}"):
        assert kind_of(ours.encode()) == ""


@pytest.mark.parametrize(
    ("name", "says"),
    [("mm", "L_0 = 200"), ("bar", "pressure_max_Pa = 5"), ("planar", "[0, 180]"), ("taper", "r = [0.04, 0.025]")],
)
def test_robot_files_of_people(name: str, says: str) -> None:
    if not ROBOTS.exists():
        pytest.skip(f"cases of {SHARED} are not on this machine")
    with pytest.raises(InputError) as raised:
        load_robot(ROBOTS / f"{name}.toml")
    assert says in str(raised.value)
    assert "; valid: " in str(raised.value)

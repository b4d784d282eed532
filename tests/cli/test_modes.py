"""`tepm robot modes`: the table, the files, what is wrong."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from control import StateSpace
from scipy.io import loadmat

from tepm_opt.models.model import write_model
from tests.cli.conftest import PNG, Command
from tests.cli.tables import input_columns, names_in, summary, write_rows
from tests.solvers.dynamics import with_dynamics

BENT = ("--pressures", "1e5,0,2e5,3e5,1e5,0", "--tensions", "1,2,3,4,5,6", "--tip-force", "0.1,0,0")


def test_table(tepm: Command, here: Path) -> None:
    done = tepm("robot", "modes")
    assert (done.status, done.err) == (0, "")
    lines = done.out.splitlines()
    assert "of 216 states about tip (0.0, 0.0, 346.8) mm" in lines[0]
    rows = [line for line in lines if " Hz" in line]
    assert rows[0].endswith("sway: first bending along x")
    assert rows[1].endswith("pressure_11 sway: first bending along y")
    assert rows[2].endswith("first twist")
    assert "0.90 Hz" in rows[0]
    assert "0.0434" in rows[0]
    assert "0.4141 ms" in done.out
    assert "6726 1/s" in done.out
    assert names_in(here) == set()


@pytest.mark.slow
@pytest.mark.usefixtures("drawn")
def test_files(tepm: Command, here: Path) -> None:
    sticky = with_dynamics(
        structural_friction={"force": 0.2, "distance": 1e-3}, creep={"share": 0.2, "relaxation_time": 1.0}, time_delay={"delay": 0.005}
    )
    write_model(sticky, here / "m.toml")
    done = tepm("robot", "modes", *BENT, "--model", "m.toml", "--from", "pressure_11,force_s4_x", "--to", "s4,length_11", "--out", "out")
    assert (done.status, done.err) == (0, "")
    assert "54 eigenvalues are 0" in done.out
    assert "72 modes, memory of the muscles" in done.out
    assert "5 ms late" in done.out
    files = names_in(here / "out")
    assert files == {"modes.csv", "state_space.mat", "summary.json", "modes.png", "bode.png", "step.png"}
    assert all((here / "out" / name).read_bytes().startswith(PNG) for name in files if name.endswith(".png"))
    told = summary(here / "out", "modes")
    assert told["states_with_eigenvalue_0"] == 54
    assert told["reduced"]["outputs"] == ["s4_x", "s4_y", "s4_z", "length_11"]
    assert told["reduced"]["error_bound_m_per_range"] <= 1e-3
    with (here / "out" / "modes.csv").open(newline="", encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    assert table[0]["shape"].startswith("memory of the muscles, ")
    sway = next(row for row in table if row["shape"].startswith("sway"))
    assert float(sway["damping"]) == pytest.approx(0.03, abs=0.02)
    assert "s4_z" in sway
    space = loadmat(here / "out" / "state_space.mat", squeeze_me=True)
    named = StateSpace(space["A"], space["B"], space["C"], space["D"], **{
        of: list(space[f"{of.removesuffix('s')}_names"]) for of in ("inputs", "outputs", "states")
    })  # fmt: skip
    assert named.state_labels[0] == "n1_0_x"
    assert space["A"].shape == (294, 294)  # 348 less 54 that stick
    assert list(space["input_names"][[0, 11, -1]]) == ["pressure_11", "tension_23", "force_s4_z"]
    assert space["output_names"][-1] == "length_23"
    assert float(space["delay_s"]) == pytest.approx(0.005)
    values = np.linalg.eigvals(space["A"])
    assert values.real.max() < 0
    assert abs(values).max() == pytest.approx(told["fastest_eigenvalue_1_per_s"])


@pytest.mark.slow
def test_the_same_twice(tepm: Command, here: Path) -> None:
    contents = []
    for name in ("a", "b"):
        assert tepm("robot", "modes", "--out", name).status == 0
        contents.append([(here / name / file).read_bytes() for file in ("state_space.mat", "modes.csv", "summary.json")])
    assert contents[0] == contents[1]


@pytest.mark.slow
def test_a_row_of_a_file_is_the_operating_point(tepm: Command, here: Path) -> None:
    rows = np.zeros((2, 13))
    rows[1] = [1, 1e5, 0, 2e5, 3e5, 1e5, 0, 1, 2, 3, 4, 5, 6]
    write_rows(here / "i.csv", input_columns(), rows)
    found = tepm("robot", "modes", "i.csv", "--row", 2, "--json").json()
    same = tepm("robot", "modes", *BENT[:4], "--json").json()
    assert found == same
    assert len(found["modes"]) == 12
    assert len(tepm("robot", "modes", "i.csv", "--json", "--count", 3).json()["modes"]) == 3


def test_no_stable_operating_point_is_explained(tepm: Command, here: Path) -> None:
    (here / "m.toml").write_text('robot = "kang2017"\n\n[[effects]]\nname = "payload"\nparameters = {mass = 1.0}\n')
    done = tepm("robot", "modes", "--model", "m.toml", "--out", "out")
    assert (done.status, done.out) == (1, "")
    assert "no stable operating point" in done.err
    assert "unstable" in done.err


@pytest.mark.sample(3)
@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--from", "pressure_31"), "unknown input 'pressure_31'"),
        (("--to", "tip"), "unknown output 'tip'"),
        (("--order", "0"), "--order 0"),
        (("--order", "999"), "order: 999; valid: 1 …"),
        (("--count", "0"), "--count 0"),
        (("--pressures", "1e5"), "--pressures"),
        (("--pressures", "9e5,0,0,0,0,0"), "pressure_11 = 900000 Pa"),
        (("i.csv", "--row", "3"), "--row 3: i.csv has no such row; valid: 1 … 1"),
        (("i.csv", "--tip-force", "1,0,0"), "exclude each other"),
        (("--row", "2"), "--row 2"),
        (("none.csv",), "none.csv"),
    ],
)
def test_wrong_input_is_one_line(tepm: Command, here: Path, options: tuple[str, ...], says: str) -> None:
    write_rows(here / "i.csv", input_columns(), np.zeros((1, 13)))
    done = tepm("robot", "modes", *options, "--out", "out")
    assert (done.status, done.out) == (2, "")
    assert says in " ".join(done.err.split())
    assert len(done.err.strip().splitlines()) == 1
    assert not (here / "out").exists() or names_in(here / "out") == set()

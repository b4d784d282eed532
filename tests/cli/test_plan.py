"""`tepm plan`: files, what is refused, what has no plan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.setpoints import read_setpoints
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import load_robot
from tepm_opt.solvers.planning.trajectories import read_trajectory
from tests.cli.conftest import PNG, Command
from tests.cli.tables import names_in, summary

MOVE = ("--from", "0.15,0,0.35", "--to", "0.05,0,0.35")
GENTLE = ("--objective", "effort", "--duration", "1")
FILES = {"inputs.csv", "reference.csv", "summary.json", "plan.png"}


def test_files_of_a_move(tepm: Command, here: Path, drawn: None) -> None:
    done = tepm("plan", *MOVE, *GENTLE, "--obstacle", "sphere:-0.2,0,0.3,0.03", "--obstacle", "box:-0.3,-0.1,0,-0.2,0.1,0.1", "--json")
    assert (done.status, done.err) == (0, "")
    folder, robot = here / "plan", load_robot("kang2017")
    assert names_in(folder) == FILES
    assert (folder / "plan.png").read_bytes().startswith(PNG)
    told = done.json()
    assert told == summary(folder, "plan")
    assert told["outcome"] == "solved"
    assert told["duration_s"] == pytest.approx(1.0)
    assert told["largest_tension_rate_N_per_s"] <= 10
    assert told["left_over_m"] <= told["left_on_rig_m"]["sway"] < told["left_on_rig_m"]["friction"]
    setpoints = read_setpoints(folder / "inputs.csv", Layout.from_robot(robot).actuator_names, robot.input_max)
    reference = read_trajectory(folder / "reference.csv")
    np.testing.assert_array_equal(setpoints.time, reference.time)
    np.testing.assert_allclose(reference.positions[[0, -1]], [[0.15, 0, 0.35], [0.05, 0, 0.35]], atol=1e-6)
    tepm("plan", "--from", "0.15,0,0.35", "--to", "0.05,0,0.65")
    assert names_in(folder) == {"summary.json"}, "files of an earlier plan are not those of this one"


@pytest.mark.slow
def test_a_path_from_a_file(tepm: Command, here: Path) -> None:
    along = np.linspace(0.15, 0.1, 7)
    (here / "way.csv").write_text("x,y,z\n" + "".join(f"{x},0,0.35\n" for x in along))
    done = tepm("plan", "--path", "way.csv", *GENTLE, "--out", "made")
    assert (done.status, done.err) == (0, "")
    assert "from rest to rest" in done.out
    assert "left on the rig: sway of" in done.out
    reference = read_trajectory(here / "made" / "reference.csv")
    assert np.abs(reference.positions[:, 1:] - [0, 0.35]).max() < 1e-5


@pytest.mark.slow
def test_room_and_doubts_are_options(tepm: Command, here: Path) -> None:
    fast, roomy = (
        tepm("plan", *MOVE, *more, "--json").json() for more in ((), ("--loop", "--frequency-doubt", "0", "--friction-doubt", "0.5"))
    )
    assert fast["duration_s"] < roomy["duration_s"]
    assert roomy["left_on_rig_m"]["sway"] == roomy["left_over_m"]
    assert roomy["left_on_rig_m"]["friction"] > 1.9 * fast["left_on_rig_m"]["friction"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--from", "0.15,0,0.35", "--to", "0.05,0,0.65"), "no plan: (0.05, 0, 0.65): out of reach"),
        ((*MOVE, "--obstacle", "sphere:0.05,0,0.35,0.02"), "no plan: end: s4 is 20.0 mm inside obstacle 1"),
    ],
)
def test_no_plan(tepm: Command, arguments: tuple[str, ...], message: str) -> None:
    done = tepm("plan", *arguments)
    assert done.status == 1
    assert message in done.out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--from", "0.1,0,0.35"), "a plan needs --from and --to, or --path"),
        ((*MOVE, "--duration", "1"), "valid: seconds for objective 'effort', none for 'time'"),
        ((*MOVE, "--obstacle", "cone:1,2,3"), "unknown kind 'cone'; valid: sphere:x,y,z,radius or box:x0,y0,z0,x1,y1,z1, in m"),
        ((*MOVE, "--obstacle", "sphere:1,2,3"), "valid: 4 numbers separated by commas"),
        ((*MOVE, "--obstacle", "sphere:1,2,3,-1"), "radius -1 m; valid: more than 0"),
        ((*MOVE, "--obstacle", "box:0,0,0,1,1,0"), "valid: corners with x0 < x1, y0 < y1 and z0 < z1"),
        ((*MOVE, "--mid-tension", "9"), "mid_tension: 9 N; valid: 0.3 … 6.7 N"),
        ((*MOVE, "--frequency-doubt", "0.9"), "frequency_uncertainty: 0.9; valid: 0 … 0.5"),
        ((*MOVE, "--friction-doubt", "2"), "friction_doubt: 2; valid: 0 … 0.9 of the tension"),
        ((*MOVE, "--max-sway", "0"), "max_sway: 0 m; valid: more than 0"),
        ((*MOVE, "--margin", "nan"), "min_stiffness: nan N/m; valid: a number"),
        (("--path", "spiral"), "unknown trajectory 'spiral'"),
    ],
)
def test_wrong_use(tepm: Command, arguments: tuple[str, ...], message: str) -> None:
    done = tepm("plan", *arguments)
    assert done.status == 2
    assert message in done.err

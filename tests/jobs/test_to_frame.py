"""Results as pandas frames: the numbers of the files that are saved, read by pandas."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.checks.findings import Finding
from tepm_opt.errors import InputError
from tepm_opt.jobs.check import CheckRun
from tepm_opt.jobs.closed_loop import LoopSetup
from tepm_opt.jobs.gain import run_gain
from tepm_opt.jobs.ik import run_ik
from tepm_opt.jobs.modes import run_modes
from tepm_opt.jobs.simulate import SimulationTask, run_simulation
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.solvers.planning.trajectories import Trajectory, circle
from tepm_opt.studies.machines.run import Drive, Family, MachinesRun

pandas = pytest.importorskip("pandas", reason="pandas is not installed (extra pandas)")


def same(run, path: Path) -> None:
    """What the file has is in the frame, under the same names."""
    frame, table = run.to_frame(), pandas.read_csv(path)
    assert set(table.columns) <= set(frame.columns)
    pandas.testing.assert_frame_equal(frame[table.columns], table, check_dtype=False, rtol=0, atol=0)


def test_points_of_a_trajectory(kang: CompiledModel, tmp_path: Path) -> None:
    """One out of reach: its row says so and has no shape where it failed."""
    targets = circle(3)
    targets = Trajectory(targets.time, targets.positions * [[1], [1], [3]], closed=False)
    run = run_ik(kang, targets)
    run.save(tmp_path)
    for name in ("inputs.csv", "shape.csv", "lengths.csv"):
        same(run, tmp_path / name)
    frame = run.to_frame()
    assert frame["ending"].tolist()[:2] == ["solved", "solved"]
    assert frame["ending"][2] != "solved"
    np.testing.assert_allclose(frame[["target_x_m", "target_y_m", "target_z_m"]], targets.positions)
    gain = run_gain(kang, run.setpoints())
    gain.save(tmp_path)
    same(gain, tmp_path / "gain.csv")


def test_motion_modes_and_machines(kang: CompiledModel, tmp_path: Path) -> None:
    motion = run_simulation(kang, SimulationTask(run_ik(kang, circle(3)).setpoints()))
    motion.save(tmp_path)
    same(motion, tmp_path / "trajectory.csv")
    same(motion, tmp_path / "lengths.csv")
    modes = run_modes(solve_statics(kang, np.zeros(12)))
    modes.save(tmp_path)
    same(modes, tmp_path / "modes.csv")
    drives = Drive(0, 1, 1e-3, 2e-3, 0, "done"), Drive(0, 2, 5e-4, 2e-3, 0, "done")
    machines = MachinesRun(LoopSetup("mpc"), Family(1, 2, 0), 3e-3, drives)
    machines.save(tmp_path)
    same(machines, tmp_path / "machines.csv")
    assert "distance_m" not in machines.to_frame()


def test_findings_are_rows() -> None:
    finding = Finding("error", "a.csv", 3, 4, "s1", "frozen")
    frame = CheckRun(Path("data"), (finding, finding)).to_frame()
    assert frame["message"].tolist() == ["frozen", "frozen"]
    assert CheckRun(Path("data"), ()).to_frame().empty


def test_without_pandas(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match="pip install pandas"):
        CheckRun(Path("data"), ()).to_frame()

"""Random machines: what varies, that a number is a machine, and controllers on some of them."""

from __future__ import annotations

import concurrent.futures
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tepm_opt import studies
from tepm_opt.data.tables import read_table
from tepm_opt.errors import InputError
from tepm_opt.hw.simulation.family import VARIED, random_machine
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.jobs.closed_loop import LoopSetup
from tepm_opt.jobs.course import Course
from tepm_opt.models.model import Model
from tepm_opt.models.robot import robot_text
from tepm_opt.outcome import Ending
from tepm_opt.solvers.planning.trajectories import circle
from tepm_opt.studies.machines.run import Drive, DriveTask, Family, MachinesRun, run_machines

QUICK = Course(approach=2.0, pause=0.2, start_up=0.5)


class TestFamily:
    def test_a_machine_is_its_seed_and_number(self) -> None:
        assert random_machine("kang2017", 3, 1) == random_machine("kang2017", 3, 1)
        assert random_machine("kang2017", 3, 1) != random_machine("kang2017", 3, 2)
        assert random_machine("kang2017", 3, 1) != random_machine("kang2017", 4, 1)

    def test_values_fill_their_ranges_and_stay_within(self) -> None:
        files = [random_machine("kang2017", 8, number) for number in range(60)]
        seen = {
            "K_a": [file.parameter_factors["K_a"] for file in files],
            "latency": [file.tracker.latency_s for file in files],
            "delay": [file.imperfections.time_delay.delay_s for file in files],
            "tendon_share": [file.imperfections.tendon_friction.share for file in files],
            "hysteresis": [file.imperfections.pressure_hysteresis.width_Pa for file in files],
            "loss": [loss for file in files for loss in file.imperfections.actuator_gain.loss.values()],
        }
        for name, values in seen.items():
            low, high = VARIED[name].low, VARIED[name].high
            assert low <= min(values) < low + 0.15 * (high - low), name
            assert high - 0.15 * (high - low) < max(values) <= high, name

    def test_devices_are_the_robot_files(self) -> None:
        """A controller that believes the file is wrong by what varies, not by more."""
        file = random_machine("kang2017", 0, 0)
        assert file.stepper.rate_limit_N_per_s == file.nominal.actuation.tension_rate_N_per_s
        assert 0.6 * 0.12 <= file.imperfections.regulator_lag.fill_s <= 1.7 * 0.12

    def test_machines_of_another_robot(self, tmp_path: Path) -> None:
        """One module: three muscles, each with a loss of its own; its motors are as quick as its file says."""
        text = (
            robot_text("kang2017")
            .replace("modules = 2", "modules = 1")
            .replace("tension_rate_N_per_s = 10.0", "tension_rate_N_per_s = 4.0")
        )
        (tmp_path / "short.toml").write_text(text, encoding="utf-8")
        file = random_machine(str(tmp_path / "short.toml"), 1, 0)
        assert len(file.imperfections.actuator_gain.loss) == 3
        assert file.stepper.rate_limit_N_per_s == 4.0
        SimulatedRig(file).read()


class TestRun:
    @pytest.mark.slow
    def test_two_machines_with_two_noises(self, tmp_path) -> None:
        """A row each, the same whichever machines are asked for; table, summary and figure."""
        task = DriveTask(Model.from_robot("kang2017"), circle(100, duration=4.0), QUICK, LoopSetup("lqg"), Family(2, 2, 6))
        with concurrent.futures.ThreadPoolExecutor(1) as executor:
            run = run_machines(task, executor=executor)
            again = run_machines(replace(task, family=Family(1, 2, 6)), executor=executor)
        assert run.ok
        assert [(drive.machine, drive.noise) for drive in run.drives] == [(0, 1), (0, 2), (1, 1), (1, 2)]
        assert again.drives == run.drives[:2]
        assert len({drive.rms_m for drive in run.drives}) == 4
        run.save(tmp_path)
        table = read_table(tmp_path / "machines.csv", text=lambda name: name == "end")
        np.testing.assert_allclose(table.column("rms_m"), run.errors, rtol=1e-6)
        assert studies.draw_machines(run, tmp_path)["machines"].is_file()
        told = run.summary()
        assert told["mean_m"] == pytest.approx(run.errors.mean())
        assert told["worst_m"] == run.errors.max()
        assert told["share_within"] == (run.errors <= 3e-3).mean()

    def test_a_run_that_ended_early_is_the_worst(self) -> None:
        drives = (Drive(0, 1, 1e-3, 2e-3, 0, "done"), Drive(1, 1, 5e-4, 2e-3, 0, "disagreed"))
        run = MachinesRun(LoopSetup("mpc"), Family(2, 1, 0), 3e-3, drives)
        told = run.summary()
        assert run.outcome.ending is Ending.FAILED
        assert "machine 1" in run.outcome.message
        assert (told["worst_machine"], told["worst_m"], told["share_within"], told["ended_early"]) == (1, None, 0.5, 1)

    def test_a_robot_without_a_file_is_refused(self) -> None:
        with pytest.raises(InputError, match="no file to draw machines around"):
            run_machines(DriveTask(replace(Model.from_robot("kang2017"), source="mine.toml"), circle(10), QUICK, LoopSetup(), Family(1)))

    @pytest.mark.parametrize("wrong", [(0, 1, 0), (1, 0, 0), (1, 1, -1)])
    def test_no_such_family(self, wrong: tuple[int, int, int]) -> None:
        with pytest.raises(InputError, match="valid"):
            Family(*wrong)

"""The virtual prototype of any robot, and rig files: written, read back, checked."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tepm_opt.errors import InputError
from tepm_opt.hw.registry import open_rig
from tepm_opt.hw.simulation.family import random_machine
from tepm_opt.hw.simulation.rigfile import RigFile, builtin_rigs, load_rig_file
from tepm_opt.hw.simulation.rigtext import rig_text
from tepm_opt.hw.simulation.scaling import scale_rig
from tepm_opt.models.robot import builtin_robots, load_robot
from tests.hw.rigs import robot_file


def test_the_papers_robot_has_the_prototype_itself() -> None:
    """Also under another name, whose numbers are the same."""
    prototype = load_rig_file()
    assert scale_rig(prototype, load_robot("kang2017")) is prototype
    renamed = scale_rig(prototype, load_robot("kang2017").model_copy(update={"name": "mine"}))
    for name in set(RigFile.model_fields) - {"name", "robot"}:
        assert getattr(renamed, name) == getattr(prototype, name), name


def test_devices_are_the_robot_files_and_the_rest_keeps_its_share() -> None:
    """Twice the pressure, half the tension, other lags: by hand."""
    changes = {"pressure_max_Pa": 0.8e6, "tension_max_N": 3.5, "filling_time_s": 0.03, "tension_rate_N_per_s": 4.0, "command_delay_s": 0.01}
    robot = load_robot(robot_file(**changes, L_0=0.1, segments_per_module=12, K_a=717.72, noise_rms_m=5e-4, latency_s=0.03))
    file, own = scale_rig(load_rig_file(), robot), load_rig_file()
    found, was = file.imperfections, own.imperfections
    assert (found.regulator_lag.fill_s, found.regulator_lag.exhaust_s, found.time_delay.delay_s) == (0.03, 0.24, 0.01)
    assert (file.stepper.rate_limit_N_per_s, file.tracker.noise_rms_m, file.tracker.latency_s) == (4.0, 5e-4, 0.03)
    assert found.pressure_hysteresis.width_Pa == pytest.approx(15000 * 1.6)
    assert (found.tendon_friction.constant_N, file.dynamometer.noise_rms_N) == pytest.approx((0.015, 0.005))
    assert (found.tendon_friction.share, found.mass_distribution) == (was.tendon_friction.share, was.mass_distribution)
    assert found.tendon_friction.bristle_stiffness_N_per_m == pytest.approx(2 * 1500)
    assert found.structural_friction.bristle_stiffness_N_per_m == pytest.approx(2 * 2 * 5000)  # edges are half as long
    assert found.rigid_plates.clamped_length_m == pytest.approx(0.3 * 0.1 / 12)  # 2.9 mm would be more than a segment bears


@pytest.mark.parametrize("name", builtin_robots())
def test_a_rig_file_reads_back_equal(name: str, tmp_path: Path) -> None:
    """As it is written, and with everything that is off switched on at what it is without."""
    for rig in builtin_rigs():
        file = scale_rig(load_rig_file(rig), load_robot(name)).model_copy(update={"robot": name})
        path = tmp_path / f"{rig}.toml"
        text = rig_text(file, name)
        path.write_text(text, encoding="utf-8")
        assert load_rig_file(path) == file
        path.write_text(re.sub(r"^# (?=\[|\w+ = )", "", text, flags=re.MULTILINE), encoding="utf-8")
        assert load_rig_file(path) == file


def test_every_muscle_of_another_robot_has_a_loss() -> None:
    losses = scale_rig(load_rig_file(), load_robot("four_muscles")).imperfections.actuator_gain.loss
    assert list(losses) == ["11", "12", "13", "14", "21", "22", "23", "24"]
    assert losses["23"] == losses["11"]
    assert len(random_machine("four_muscles", 1, 0).imperfections.actuator_gain.loss) == 8


def test_sim_follows_the_robot_and_a_file_does_not(tmp_path: Path) -> None:
    """A rig file of another robot is refused with what can be done."""
    short = load_robot(robot_file(modules=1))
    assert open_rig("sim@mujoco", short).robot == short
    path = tmp_path / "rig.toml"
    path.write_text(rig_text(load_rig_file(), "kang2017"), encoding="utf-8")
    says = r"simulates the robot 'kang2017', .*--robot kang2017\), take --rig sim, .* tepm hw rig new FILE"
    with pytest.raises(InputError, match=says):
        open_rig(f"sim:{path}", short)

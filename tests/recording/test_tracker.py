"""Noise and latency of a tracker come back from rigs that have known ones."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.cli import run
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Sample
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import RigFile
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.robot import load_robot, robot_text
from tepm_opt.recording.tracker import coordinate_noise, evaluate_tracker, fit_delay, record_tracker, sine_of

OTHER = 'name = "other"\nrobot = "kang2017"\n[tracker]\nlatency_s = 0.04\nnoise_rms_m = 4.0e-4\n'
LATE_S = 0.03


class Misdated(SimulatedRig):
    """A rig whose tracker takes poses for 30 ms younger than they are."""

    def read_many(self, count: int) -> list[Sample]:
        """As `SimulatedRig.read_many`."""
        return [replace(sample, time=sample.time + LATE_S) for sample in super().read_many(count)]


def test_noise_is_that_about_a_slow_trend() -> None:
    """A drift of 2 mm and a few strays do not count; a point that was lost has none."""
    random, times = np.random.default_rng(1), np.arange(2000) / 100
    sigma = np.array([[3e-4, 1e-4, 5e-4], [1e-3, 1e-3, 1e-3]])
    points = sigma * random.normal(size=(2000, 2, 3)) + 2e-3 * (times / 20)[:, None, None] ** 2
    points[::100] += 0.05
    points[:, 1] = np.nan
    found = coordinate_noise(times, points)
    np.testing.assert_allclose(found[0], sigma[0], rtol=0.08)
    assert np.isnan(found[1]).all()


@pytest.mark.parametrize("delay", [-0.04, 0.0, 0.123])
def test_the_delay_and_its_standard_error(delay: float) -> None:
    """Of scaled, offset, noisy positions: within three standard errors, which are right to a third over many draws."""
    random, times = np.random.default_rng(2), np.arange(800) / 100
    moved = np.stack([0.02 * np.sin(2.2 * times), 0.01 * np.cos(2.2 * times), 0 * times], axis=1)[:, None]
    late = np.stack([0.03 * np.sin(2.2 * (times - delay)), 0.01 * np.cos(2.2 * (times - delay)) + 0.2, 0 * times], axis=1)[:, None]
    fits = np.array([fit_delay(times, late + 5e-4 * random.normal(size=late.shape), times, moved) for _ in range(20)])
    assert abs(fits[:, 0].mean() - delay) < 3 * fits[:, 1].mean() / np.sqrt(20) + 1e-4
    assert fits[:, 0].std() == pytest.approx(fits[:, 1].mean(), rel=0.4)
    np.testing.assert_allclose(fits[:, 2], 5e-4, rtol=0.1)


def test_too_few_positions() -> None:
    with pytest.raises(InputError, match="valid: sensors in sight"):
        fit_delay(np.arange(200) / 100, np.full((200, 1, 3), np.nan), np.arange(200) / 100, np.zeros((200, 1, 3)))


def test_the_sine_is_slow_and_small() -> None:
    """It begins and ends at zero, leaves most of the range alone, and the motor can follow it."""
    robot = load_robot("kang2017")
    sine = sine_of(robot, 3, False, 2.5)
    assert not sine.inputs[[0, -1]].round(12).any()
    assert sine.inputs.max() <= 0.4 * robot.actuation.tension_max_N + 1e-12
    assert np.abs(np.diff(sine.inputs[:, 9]) / np.diff(sine.time)).max() < robot.actuation.tension_rate_N_per_s
    assert np.flatnonzero(sine.inputs.any(axis=0)).tolist() == [9]


@pytest.mark.slow
@pytest.mark.parametrize(("rig", "noise", "latency"), [("virtual_prototype", 1e-3, 0.015), ("other", 4e-4, 0.04)])
def test_noise_and_latency_of_a_simulated_rig(rig: str, noise: float, latency: float, kang: CompiledModel, tmp_path: Path) -> None:
    """Both within a tenth, also where the model knows nothing of the prototype's friction."""
    (tmp_path / "other.toml").write_text(OTHER)
    opened = SimulatedRig(str(tmp_path / "other.toml") if rig == "other" else rig)
    found = evaluate_tracker(record_tracker(opened, opened.robot, 3), kang)
    assert found.noise_rms_m == pytest.approx(noise, rel=0.1)
    assert found.latency_s == pytest.approx(latency, rel=0.1)
    assert not found.stamps_are_off
    assert found.rate_Hz == pytest.approx(100)


@pytest.mark.slow
def test_time_stamps_that_are_wrong(kang: CompiledModel) -> None:
    """The motion tells: the latency is that of the poses, not that of their stamps."""
    tracker = {"latency_s": 0.04, "noise_rms_m": 4e-4}
    rig = Misdated(RigFile.model_validate({"name": "misdated", "robot": "kang2017", "tracker": tracker}))
    found = evaluate_tracker(record_tracker(rig, rig.robot, 3), kang)
    assert found.age_s == pytest.approx(0.04 - LATE_S)
    assert found.stamps_are_off
    assert found.latency_s == pytest.approx(0.04, rel=0.1)


@pytest.mark.slow
def test_the_command_writes_into_the_robot_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two numbers change, and nothing else of the file; a built-in robot has no file to write into."""
    mine, other = tmp_path / "mine.toml", tmp_path / "other.toml"
    mine.write_text(robot_text("kang2017"))
    other.write_text(OTHER.replace("kang2017", "mine.toml"))
    assert run(["hw", "measure", "tracker", "--rig", f"sim:{other}", "--robot", str(mine), "--write", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["written"] == {"tracker": {"noise_rms_m": pytest.approx(4e-4, rel=0.1), "latency_s": pytest.approx(0.04, rel=0.1)}}
    before, after = robot_text("kang2017").splitlines(), mine.read_text().splitlines()
    assert len(before) == len(after)
    assert sum(a != b for a, b in zip(before, after, strict=True)) == 2
    assert load_robot(mine).tracker.latency_s == told["written"]["tracker"]["latency_s"]
    assert run(["hw", "measure", "tracker", "--write"]) == 2
    assert "no robot file" in capsys.readouterr().err

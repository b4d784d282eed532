"""What is told of gauges and a tracker that do not make sense, and what is not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from tepm_opt.control.actuation.actuators import Actuators
from tepm_opt.control.actuation.regulator_lags import RegulatorLags
from tepm_opt.control.diagnostics.sensors import LARGEST, STAYS, SensorDiagnostics, TrackerNoise
from tepm_opt.control.loop import LoopRecord, close_loop
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.control.references.reference import Reference
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.hw.simulation.family import random_machine
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import RigFile, load_rig_file
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.devices import Devices
from tests.control.study import WIDE, prototype, reference
from tests.control.study_valves import LateMonitors, with_lags

NAMES = ("11", "12", "13")


def moving(count: int, noise: float, seed: int = 1) -> np.ndarray:
    """Four points that sway by 100 mm at 1 Hz, sampled at 100 Hz with noise, (count, 4, 3) in m."""
    sway = 0.1 * np.sin(2 * np.pi * np.arange(count) / 100)[:, None, None] * np.ones((1, 4, 3))
    return sway + noise * np.random.default_rng(seed).standard_normal(sway.shape)


@pytest.mark.parametrize("true", [3e-4, 6e-4, 1.8e-3])
def test_noise_is_measured_while_the_arm_moves(true: float) -> None:
    """Within a tenth, with some points lost, whatever is declared."""
    noise, points = TrackerNoise(6e-4), moving(120, true)
    points[::7, 2] = np.nan
    found = [noise.add(row) for row in points]
    assert found[50] == 6e-4, "as declared until a second has passed"
    assert found[-1] == pytest.approx(true, rel=0.1)


def test_what_is_believed_has_bounds() -> None:
    noise = TrackerNoise(1e-4)
    for row in moving(120, 5e-3):
        noise.add(row)
    assert noise.measured == pytest.approx(LARGEST * 1e-4)


def told_now(doubts: SensorDiagnostics, actuators: Actuators, noise: TrackerNoise, late: float) -> Mapping[str, str]:
    """Sentences after one more sample."""
    doubts.count(actuators.offsets)
    return doubts.sentences(doubts.lasting, actuators.offsets, (noise.measured, noise.declared), late, actuators.lags.findings)


def test_a_difference_is_told_once_it_stays() -> None:
    """By name, size and way; a short one, or a small one, is not."""
    devices = Devices(0.1, 0.1, np.inf, 0.0)
    actuators = Actuators(devices, 5e-5, Command.from_inputs(np.zeros(6)), RegulatorLags(devices, 0.01, np.full(3, 5e5)))
    doubts, noise = SensorDiagnostics(NAMES, (np.full(3, 5e5), np.full(3, 7.0))), TrackerNoise(6e-4)
    actuators.tension_offset = np.array([0.0, -0.4, 0.1])
    told = [told_now(doubts, actuators, noise, 0.0) for _ in range(STAYS + 1)]
    assert not any(told[:STAYS])
    assert list(told[-1]) == ["dynamometer 12"]
    assert "dynamometer 12 reads 0.4 N low" in told[-1]["dynamometer 12"]
    actuators.tension_offset[:] = 0.0
    assert not told_now(doubts, actuators, noise, 0.0)
    assert "20 ms later" in told_now(doubts, actuators, noise, 0.020)["command delay"]
    actuators.lags.shares = 1 - np.exp(-0.01 / np.array([[0.1, 0.1, 0.025], [0.1, 0.1, 0.1]]))
    actuators.lags.covariance[0, 0, 2], actuators.lags._misfit, actuators.lags._off = 0.01, np.zeros(3), np.zeros(3)
    assert list(told_now(doubts, actuators, noise, 0.0)) == ["regulator 13"]
    assert "fills 4 and exhausts 1 times as quickly" in told_now(doubts, actuators, noise, 0.0)["regulator 13"]
    assert "15 ms sooner" in told_now(doubts, actuators, noise, -0.015)["command delay"]


def test_a_noisy_monitor_is_told_and_not_believed() -> None:
    """20 kPa in one of three within 0.5 s, while commands step by 20 kPa and one regulator has no lag; of the others only that."""
    devices, random = Devices(0.1, 0.1, np.inf, 0.0), np.random.default_rng(2)
    actuators = Actuators(devices, 5e-5, Command.from_inputs(np.full(6, 2e5)), RegulatorLags(devices, 0.01, np.full(3, 5e5), 2e5))
    doubts, noise, true = SensorDiagnostics(NAMES, (np.full(3, 5e5), np.full(3, 7.0))), TrackerNoise(6e-4), np.full(3, 2e5)
    told = []
    for k in range(200):
        command = 2e5 + 2e4 * (-1.0) ** (k // 10) * np.ones(3)
        actuators.command = Command.from_inputs(np.concatenate([command, np.zeros(3)]))
        true = command + (true - command) * np.exp([-0.1, -0.1, -50.0])
        actuators.advance()
        readings = true + np.array([2e4, 1e3, 1e3]) * random.normal(size=3)
        actuators.correct(Sample(0.01 * k, np.zeros((4, 3)), readings, np.zeros(3)), 0.01)
        told.append(told_now(doubts, actuators, noise, 0.0))
    assert list(told[50]) == ["noise of monitor 11", "regulator 13"]
    assert all("noise of monitor 12" not in each and "noise of monitor 13" not in each for each in told)
    assert actuators.lags.noise[0] == pytest.approx(2e4, rel=0.3)
    assert actuators.lags.believed.tolist() == [False, True, True]
    assert actuators.lags.unmonitored.tolist() == [True, False, True]  # that of the valve without a lag tells no more than the command


def test_quick_regulators_without_monitors_are_told() -> None:
    """Once the doubt about them leaves no other way."""
    devices = Devices(0.1, 0.1, np.inf, 0.0)
    lags = RegulatorLags(devices, 0.01, np.full(3, 5e5))
    actuators = Actuators(devices, 5e-5, Command.from_inputs(np.zeros(6)), lags)
    doubts, noise = SensorDiagnostics(NAMES, (np.full(3, 5e5), np.full(3, 7.0))), TrackerNoise(6e-4)
    lags.nearest_factor = 0.6
    assert not told_now(doubts, actuators, noise, 0.0)
    lags.nearest_factor = 0.25
    assert "act 4 times as quickly" in told_now(doubts, actuators, noise, 0.0)["regulators"]
    lags.correct(np.zeros(3), 0.01)
    assert not told_now(doubts, actuators, noise, 0.0)


def driven(kang: CompiledModel, short: Reference, file: RigFile, noise: int = 1) -> LoopRecord:
    rig = SimulatedRig(file)
    rig.reseed(noise)
    return close_loop(rig, Mpc(kang, short), kang.robot)


def mean_error(kang: CompiledModel, short: Reference, file: RigFile) -> float:
    """Mean of three noises, from which errors of a second on the path depend much."""
    return float(np.mean([driven(kang, short, file, noise).error() for noise in (1, 2, 3)]))


@pytest.fixture(scope="module")
def usual(kang: CompiledModel, short: Reference) -> float:
    """Mean error with regulators as the file says."""
    return mean_error(kang, short, load_rig_file())


@pytest.mark.slow
@pytest.mark.parametrize("which", [[2], [0, 1, 2, 3, 4, 5]])
def test_a_monitor_that_lies_teaches_no_lags(kang: CompiledModel, short: Reference, followed: LoopRecord, which: list[int]) -> None:
    """Stuck but for its noise, or all 0.1 s late: a controller that believed it would lead by lags that are not there."""

    class Lying(SimulatedRig):
        def read(self) -> Sample:
            sample = super().read()
            seen.append(np.array(sample.pressures))
            pressures = seen[-1].copy()
            pressures[which] = 2e5 + 1e3 * np.sin(len(seen)) if len(which) == 1 else seen[max(len(seen) - 11, 0)]
            return replace(sample, pressures=pressures)

    seen: list[np.ndarray] = []
    rig = Lying(load_rig_file())
    rig.reseed(1)
    done = close_loop(rig, Mpc(kang, short), kang.robot)
    assert done.error() < 3 * followed.error() + 2e-4
    assert not any(about.startswith("regulator") for about in done.telemetry[-1].doubts)


@pytest.mark.slow
@pytest.mark.parametrize("part", [0.4, 0.25, 0.08, 0.0])
def test_regulators_quicker_than_the_file_says_are_learned_and_told(
    kang: CompiledModel, short: Reference, usual: float, part: float
) -> None:
    """By a controller that took the file's word they threw the arm off its path."""
    file = load_rig_file()
    lag = file.imperfections.regulator_lag
    quick = lag.model_copy(update={"fill_s": part * lag.fill_s, "exhaust_s": part * lag.exhaust_s})
    file = file.model_copy(update={"imperfections": file.imperfections.model_copy(update={"regulator_lag": quick})})
    assert mean_error(kang, short, file) < 1.5 * usual + 2e-4
    assert any(about.startswith("regulator") for about in driven(kang, short, file).telemetry[-1].doubts)


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 17])
def test_valves_without_a_lag_keep_a_late_machine_on_its_path(kang: CompiledModel, number: int) -> None:
    """Monitors read a part of a period early beside its tracked points; they were called noisy, and the arm was thrown 11 and 27 mm off."""
    file = random_machine("kang2017", 95001, number)
    lag = file.imperfections.regulator_lag.model_copy(update={"fill_s": 0.0, "exhaust_s": 0.0})
    file = file.model_copy(update={"imperfections": file.imperfections.model_copy(update={"regulator_lag": lag})})
    done = close_loop(prototype(1, file), Mpc(kang, reference("circle", known=kang)), kang.robot, WIDE)
    assert done.error() < 4e-3
    assert any("times as quickly" in text for text in done.telemetry[-1].doubts.values())
    assert not any(about.startswith("noise of monitor") for about in done.telemetry[-1].doubts)


def with_monitors(file: RigFile, **values: object) -> RigFile:
    """A rig with other pressure monitors."""
    return file.model_copy(update={"pressure_monitor": file.pressure_monitor.model_copy(update=values)})


@pytest.mark.slow
@pytest.mark.parametrize("part", [0.25, 0.0])
def test_quick_regulators_without_monitors_keep_to_the_path(kang: CompiledModel, short: Reference, usual: float, part: float) -> None:
    """From tracked points alone; with the file's lags they threw the arm off its path, or made it sway."""
    file = with_monitors(load_rig_file(), fitted=False)
    lag = file.imperfections.regulator_lag
    quick = lag.model_copy(update={"fill_s": part * lag.fill_s, "exhaust_s": part * lag.exhaust_s})
    file = file.model_copy(update={"imperfections": file.imperfections.model_copy(update={"regulator_lag": quick})})
    assert mean_error(kang, short, file) < 1.8 * usual + 2e-4


@pytest.mark.slow
def test_the_perfect_rig_keeps_to_the_path(kang: CompiledModel, short: Reference) -> None:
    """Without monitors and lags; the file's lags stopped the loop. Where the path ends at full speed, the arm jerks."""
    done = driven(kang, short, load_rig_file("perfect"))
    assert done.outcome.solved
    assert np.linalg.norm(np.array(done.truth) - done.targets, axis=1)[300:430].max() < 2e-3


@pytest.mark.slow
def test_noisy_monitors_harm_nothing_and_are_told(kang: CompiledModel, short: Reference, followed: LoopRecord) -> None:
    """20 kPa in all: within three seconds, and the arm goes as without them."""
    done = driven(kang, short, with_monitors(load_rig_file(), noise_rms_Pa=2e4))
    assert done.error() < 1.3 * followed.error() + 2e-4
    told = [at for at, row in zip(done.time, done.telemetry, strict=True) if sum(about.startswith("noise") for about in row.doubts) == 6]
    assert told[0] < 3.0


@pytest.mark.slow
@pytest.mark.parametrize(("part", "late"), [(1.0, 10), (0.25, 5)])
def test_late_monitors_harm_nothing_and_are_told(
    kang: CompiledModel, short: Reference, followed: LoopRecord, part: float, late: int
) -> None:
    """All 0.1 or 0.05 s late. Beside quick valves the arm was thrown by 66 mm."""
    rig = LateMonitors(with_lags(part), late)
    rig.reseed(2)
    done = close_loop(rig, Mpc(kang, short), kang.robot)
    assert done.error() < 1.8 * followed.error() + 2e-4
    assert done.outcome.solved
    told = [at for at, row in zip(done.time, done.telemetry, strict=True) if "pressure monitors" in row.doubts]
    assert told[0] < 2.0


@pytest.mark.slow
def test_a_low_dynamometer_harms_nothing_and_is_told(kang: CompiledModel, short: Reference, followed: LoopRecord) -> None:
    """0.4 N low in all muscles: commands are relative to the tension, so that it would add up until the motors let go."""
    file = load_rig_file()
    done = driven(kang, short, file.model_copy(update={"dynamometer": file.dynamometer.model_copy(update={"offset_N": -0.4})}))
    assert done.error() < 1.3 * followed.error() + 2e-4
    assert min(command.tensions.min() for command in done.commands[250:]) > 1.0
    told = [k for k, row in enumerate(done.telemetry) if len(row.doubts) == 6]
    assert done.time[told[0]] < 2.0
    assert not any(row.doubts for row in followed.telemetry), "nothing is told of a machine without such an error"


BEGINS = 2.5  # s


class Dead(SimulatedRig):
    """The virtual prototype whose dynamometers read 0 from some time on."""

    def read(self) -> Sample:
        """As of the rig, but for the tensions."""
        sample = super().read()
        return replace(sample, tensions=np.zeros(6)) if sample.time > BEGINS else sample


class Slipping(SimulatedRig):
    """The virtual prototype on which the tip's marker slips by 5 mm."""

    def read(self) -> Sample:
        """As of the rig, but for the tip."""
        sample = super().read()
        off = np.zeros((4, 3))
        off[-1, 0] = 5e-3 * (sample.time > BEGINS)
        return replace(sample, points=sample.points + off)


@pytest.mark.slow
def test_a_marker_that_slips_is_told_and_taken_off(kang: CompiledModel, short: Reference, followed: LoopRecord) -> None:
    """Followed it would be 5 mm; what remains is what the noise leaves of the estimate of the jump."""
    rig = Slipping(load_rig_file())
    rig.reseed(1)
    done = close_loop(rig, Mpc(kang, short), kang.robot)
    assert done.error() < followed.error() + 2e-3
    assert list(done.telemetry[-1].doubts) == ["marker s4"]
    first = next(time for time, row in zip(done.time, done.telemetry, strict=True) if row.doubts)
    assert BEGINS < first < BEGINS + 0.2


@pytest.mark.slow
def test_dead_dynamometers_are_not_believed(kang: CompiledModel, short: Reference, followed: LoopRecord) -> None:
    """Read as tensions they would let the tip go by a decimetre, and as motors that are late by 80 ms."""
    rig = Dead(load_rig_file())
    rig.reseed(1)
    done = close_loop(rig, Mpc(kang, short), kang.robot)
    assert done.error() < 1.3 * followed.error() + 2e-4
    assert set(done.telemetry[-1].doubts) == {f"dynamometer {name}" for name in kang.layout.actuator_names}


@pytest.mark.slow
def test_a_noisy_tracker_is_told_and_reckoned_with(kang: CompiledModel, short: Reference) -> None:
    """Three times the noise declared: hardly a point is refused, and the innovations are as large as they should be."""
    file = load_rig_file()
    done = driven(kang, short, file.model_copy(update={"tracker": file.tracker.model_copy(update={"noise_rms_m": 3e-3})}))
    assert list(done.telemetry[-1].doubts) == ["tracker noise"]
    late = done.telemetry[150:]
    assert np.mean([row.columns["points_refused"] for row in late]) < 0.02
    assert np.mean([row.columns["nis"] for row in late]) / 12 == pytest.approx(1.0, abs=0.3)


@pytest.mark.slow
def test_a_wrong_pressure_monitor_is_told(kang: CompiledModel, short: Reference, followed: LoopRecord) -> None:
    """20 kPa high in all: within two and a half seconds, and the arm is where it was."""
    file = load_rig_file()
    done = driven(kang, short, file.model_copy(update={"pressure_monitor": file.pressure_monitor.model_copy(update={"offset_Pa": 2e4})}))
    assert done.error() < 1.3 * followed.error() + 2e-4
    told = [k for k, row in enumerate(done.telemetry) if len(row.doubts) == 6]
    assert done.time[told[0]] < 2.5
    assert "reads 20 kPa high" in done.telemetry[-1].doubts["pressure monitor 11"]


@pytest.mark.slow
def test_late_commands_are_told_and_reckoned_with(kang: CompiledModel, short: Reference, followed: LoopRecord) -> None:
    """20 ms later than the robot file says: known within half a second from the dynamometers; ignored it is some 10 mm."""
    file = load_rig_file()
    late = file.imperfections.time_delay.model_copy(update={"delay_s": 0.025})
    done = driven(kang, short, file.model_copy(update={"imperfections": file.imperfections.model_copy(update={"time_delay": late})}))
    assert done.error() < 2.5 * followed.error()
    assert "20 ms later" in done.telemetry[-1].doubts["command delay"]
    first = next(time for time, row in zip(done.time, done.telemetry, strict=True) if row.doubts)
    assert first < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("number", range(4))
def test_nothing_is_told_of_ordinary_machines(kang: CompiledModel, short: Reference, number: int) -> None:
    """Lags, delays, friction and strengths that differ from the robot file as machines do are no gauge that lies."""
    done = driven(kang, short, random_machine("kang2017", 77, number))
    assert not {about for row in done.telemetry for about in row.doubts}

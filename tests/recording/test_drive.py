"""Driving a rig: slow where it has to be slow, on time where it has to be on time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.run import read_run
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.hw.guard import Stopped
from tepm_opt.jobs.play import play
from tepm_opt.models.channels import channels_of
from tepm_opt.recording.drive import FULL_RANGE, Driver, Row, at_rest
from tests.recording.fake_rig import PERIOD, ROBOT, FakeRig, FakeSimulation

CHANNELS = channels_of(ROBOT)


def ramp(duration: float = 2.0) -> SetPoints:
    """A second of rest, then 11's pressure rises by 100 kPa a second and 21's tension by 1 N a second."""
    time = np.array([0.0, 1.0, 1.0 + duration])
    inputs = np.tile(np.repeat([1e5, 0.5], 6), (3, 1))
    inputs[2, [0, 9]] += np.array([1e5, 1.0]) * duration
    return SetPoints(time, inputs, np.zeros((3, 3)))


def expected(setpoints: SetPoints, time: float) -> np.ndarray:
    return np.array([np.interp(time, setpoints.time, column) for column in setpoints.inputs.T])


def follow(rig: FakeRig, setpoints: SetPoints, rate: float = 50.0) -> list[Row]:
    driver = Driver(rig, CHANNELS)
    driver.start(setpoints)
    return list(driver.follow(setpoints, rate))


class TestApproach:
    def test_slow_and_smooth(self) -> None:
        rig = FakeRig()
        driver = Driver(rig, CHANNELS)
        target = np.repeat([4e5, 6.0], 6)
        driver.approach(target)
        commands = np.array([inputs for _, inputs in rig.applied])
        assert np.all(np.diff(commands, axis=0) >= -1e-9 * ROBOT.input_max)
        fastest = np.max(np.diff(commands, axis=0) / ROBOT.input_max) / PERIOD
        assert fastest <= 1.5 / FULL_RANGE * 1.01, "a share of the range a second"
        np.testing.assert_allclose(commands[-1], target)

    def test_from_where_the_rig_is(self) -> None:
        rig = FakeRig()
        rig.state[:6] = 2e5
        Driver(rig, CHANNELS).approach(np.repeat([3e5, 0.0], 6))
        np.testing.assert_allclose(rig.applied[0][1][:6], 2e5, rtol=0.1)

    def test_waits_for_rest(self) -> None:
        rig, setpoints = FakeRig(), ramp()
        driver = Driver(rig, CHANNELS)
        assert driver.start(setpoints)
        np.testing.assert_allclose(rig.state, setpoints.inputs[0], rtol=2e-3)

    @pytest.mark.slow
    def test_gives_up_on_a_robot_that_never_rests(self) -> None:
        class Swaying(FakeRig):
            def read(self):
                sample = super().read()
                return replace(sample, points=sample.points + np.array([0.01 * np.sin(5.6 * sample.time), 0, 0]))

        rig = Swaying()
        assert not Driver(rig, CHANNELS).start(ramp())
        assert rig.ticks * PERIOD < 60

    def test_a_simulation_rests_there_at_once(self) -> None:
        setpoints = replace(ramp(), tip_force=np.tile([0.0, 0.0, -0.1], (3, 1)))
        rig = FakeSimulation()
        assert Driver(rig, CHANNELS).start(setpoints, at_once=True)
        assert [inputs.tolist() for _, inputs in rig.applied] == [setpoints.inputs[0].tolist()]
        assert rig.ticks == 2
        np.testing.assert_array_equal(rig.pushed, setpoints.tip_force[0])

    def test_back_to_zero(self) -> None:
        rig = FakeRig()
        driver = Driver(rig, CHANNELS)
        driver.approach(np.repeat([2e5, 1.0], 6))
        before = len(rig.applied)
        driver.finish()
        commands = np.array([inputs for _, inputs in rig.applied[before:]])
        assert np.all(np.diff(commands, axis=0) <= 1e-9)
        assert not commands[-1].any()
        assert rig.stops == 1


class TestFollow:
    @pytest.mark.parametrize(("rate", "rows"), [(50.0, 151), (100.0, 301), (25.0, 76), (100 / 3, 101)])
    def test_rows_on_time(self, rate: float, rows: int) -> None:
        setpoints = ramp()
        found = follow(FakeRig(), setpoints, rate)
        assert len(found) == rows
        np.testing.assert_allclose([row.time for row in found], np.arange(rows) / rate, atol=1e-9)
        for row in found:
            np.testing.assert_allclose(row.inputs, expected(setpoints, row.time))
            assert row.late == 0.0

    def test_a_simulation_is_given_them_in_advance(self) -> None:
        setpoints, rig = ramp(), FakeSimulation()
        driver = Driver(rig, CHANNELS)
        driver.start(setpoints, at_once=True)
        before = len(rig.applied)
        rows = list(driver.follow(setpoints, 50.0))
        assert rig.scheduled is not None
        begin, told = rig.scheduled
        assert len(rig.applied) == before
        for row in rows:
            np.testing.assert_allclose(row.inputs, expected(setpoints, row.time))
            np.testing.assert_allclose(expected(told, row.sample.time - begin), row.inputs)

    def test_commands_are_on_average_on_time(self) -> None:
        rig, setpoints = FakeRig(), ramp()
        driver = Driver(rig, CHANNELS)
        driver.start(setpoints)
        before, begin = len(rig.applied), None
        rows = []
        for row in driver.follow(setpoints, 100.0):
            begin = row.sample.time if begin is None else begin
            rows.append(row)
        assert begin is not None
        late = []
        for time, inputs in rig.applied[before:]:
            if 1.1 < time - begin < 2.9:  # held until the next one: its middle is half a period on
                late.append(time + PERIOD / 2 - begin - 1.0 - (inputs[0] - 1e5) / 1e5)
        assert np.abs(np.mean(late)) < 1e-3
        assert len(late) > 100

    def test_a_late_command_is_told(self) -> None:
        setpoints, rig = ramp(), FakeRig()
        driver = Driver(rig, CHANNELS)
        driver.start(setpoints)
        rig.gaps[rig.ticks + 150] = 30
        late = [(row.time, row.late) for row in driver.follow(setpoints, 50.0) if row.late]
        assert len(late) == 1
        assert late[0][1] == pytest.approx(0.31, abs=0.02)

    @pytest.mark.parametrize(("rate", "valid"), [(200.0, "valid: 100, 50, 33.33"), (60.0, "valid: 100, 50"), (45.0, "valid: 100, 50")])
    def test_rates_the_rig_does_not_have(self, rate: float, valid: str) -> None:
        with pytest.raises(InputError, match=valid):
            follow(FakeRig(), ramp(), rate)

    def test_slow_rates_need_not_divide(self) -> None:
        rows = follow(FakeRig(), ramp(8.0), 7.0)
        np.testing.assert_allclose([row.time for row in rows], np.arange(64) / 7, atol=0.006)

    def test_another_robot(self) -> None:
        with pytest.raises(InputError, match="the rig gives 4 points, the robot has 2"):
            Driver(FakeRig(), replace(CHANNELS, points=("s1", "s2"))).read()

    def test_time_that_stands_still(self) -> None:
        rig = FakeRig()
        driver = Driver(rig, CHANNELS)
        driver.read()
        rig.read = lambda: driver.sample  # type: ignore[method-assign]
        with pytest.raises(RuntimeError, match=r"stands still at 0\.01 s"):
            driver.settle()


class TestRest:
    def seen(self, amplitude: float, noise: float, rows: int = 120) -> np.ndarray:
        time = np.arange(rows) * PERIOD
        points = noise * np.random.default_rng(5).normal(size=(rows, 4, 3))
        points[:, 3, 0] += amplitude * np.sin(2 * np.pi * 0.9 * time)
        return points

    @pytest.mark.parametrize("noise", [0.0, 3e-4, 1e-3])
    def test_noise_is_no_motion(self, noise: float) -> None:
        assert at_rest(self.seen(0.0, noise))
        assert not at_rest(self.seen(5e-3, noise))

    def test_lost_points_are_not_asked(self) -> None:
        points = self.seen(5e-3, 3e-4)
        points[:, 3] = np.nan
        points[::7, 2] = np.nan
        assert at_rest(points)

    def test_too_few(self) -> None:
        assert not at_rest(self.seen(0.0, 0.0, rows=8))


@pytest.mark.parametrize(
    ("values", "says"),
    [
        (np.full(6, 5.4e5), "measured pressure_11 is 108 % of its limit"),
        (np.full(6, np.nan), "pressure_11 was not measured for 0.2 s"),
        (None, "pressure_11 was not measured for 0.2 s"),
    ],
)
def test_a_run_that_is_stopped_keeps_what_it_has(tmp_path: Path, values: np.ndarray | None, says: str) -> None:
    """Pressures that are too high, or not there any more, in the middle of a run: the rig is stopped, its rows stay."""
    rig = FakeRig()
    rig.wrong_from, rig.wrong = 900, values
    setpoints = SetPoints(np.array([0.0, 20.0]), np.repeat([[1e5] * 6 + [0.5] * 6], 2, axis=0), np.zeros((2, 3)))
    with pytest.raises(Stopped, match=says):
        play(rig, setpoints, ROBOT, tmp_path / "out.csv")
    assert rig.stops == 1
    assert 900 <= rig.ticks <= 925
    rows = read_run(tmp_path / "out-1.unfinished.csv").rows
    assert rows > 100
    assert not (tmp_path / "out.csv").exists()

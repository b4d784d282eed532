"""Coarse pressures, and what a controller knows of the devices between commands and forces."""

import numpy as np
import pytest

from tepm_opt.control.actuation.actuators import Actuators, InputEffects
from tepm_opt.control.actuation.delay_line import MOST_LATE, CommandDelayLine
from tepm_opt.control.actuation.pressure_planner import PressurePlanner, PressurePlannerSettings
from tepm_opt.control.actuation.regulator_lags import RegulatorLags
from tepm_opt.control.estimation.dahl_friction import dahl_sequence, dahl_step
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.models.compile import compile_model
from tepm_opt.models.devices import Devices
from tepm_opt.models.effects import _registry, find_effect
from tepm_opt.models.model import Model

NOMINAL = Model.from_robot("kang2017")
AREA, STEP, STAGE = 50.27e-6, 4500.0, 0.02
DEVICES = Devices(filling=0.12, exhausting=0.24, tension_rate=10.0, delay=0.005)
LIMITS = np.full(6, 0.5e6)
LAGS = RegulatorLags(DEVICES, STAGE / 2, LIMITS)


def planner(**settings) -> PressurePlanner:
    """For the usual regulators."""
    return PressurePlanner(LIMITS, STEP, PressurePlannerSettings(**settings))


def actuators_at(pressure: float, tension: float, devices: Devices = DEVICES) -> Actuators:
    """The usual devices at rest in Pa and N."""
    command = Command.from_inputs(np.append(np.full(6, pressure), np.full(6, tension)))
    return Actuators(devices, AREA, command, RegulatorLags(devices, STAGE / 2, LIMITS, pressure))


def test_pressures_stay_on_the_grid_and_within_the_limits():
    """Whatever is needed, also far beyond what the muscles can do."""
    random, tested = np.random.default_rng(4), planner()
    command, pressure = np.zeros(6), np.zeros(6)
    for _ in range(200):
        command, reached = tested.plan(8e5 * random.normal(size=(29, 6)), command, pressure, 15, LAGS)
        pressure = reached[0]
        assert command / STEP == pytest.approx(np.round(command / STEP), abs=1e-9)
        assert ((command >= 0) & (command <= 0.5e6)).all()
        assert ((reached >= 0) & (reached <= 0.5e6)).all()
    assert tested.plan(np.full((29, 6), 2e7), command, pressure, 15, LAGS)[0] == pytest.approx(111 * STEP)


@pytest.mark.parametrize(("steps", "moves"), [(0.4, False), (2.9, False), (3.1, True), (-2.9, False), (-3.1, True)])
def test_pressure_moves_only_when_it_is_worth_a_move(steps, moves):
    """By whole steps, to the nearest to what is needed; less than `deadband` steps off is left alone."""
    command = np.full(6, 20 * STEP)
    new, _ = planner(deadband=3.0).plan(np.full((29, 6), (20 + steps) * STEP), command, command, 15, LAGS)
    assert new == pytest.approx((20 + round(steps)) * STEP if moves else command)


@pytest.mark.parametrize(("filling", "steps", "moves"), [(0.005, 1.4, True), (0.005, 0.9, False), (0.03, 1.4, False), (0.03, 1.6, True)])
def test_quick_regulators_move_by_less(filling: float, steps: float, moves: bool) -> None:
    """One step of the grid for a lag of 5 ms, one and a half for 30 ms: half the lag of a whole deadband."""
    lags = RegulatorLags(Devices(filling, 0.24, 10.0, 0.005), STAGE / 2, LIMITS)
    command = np.full(6, 20 * STEP)
    new, _ = planner().plan(np.full((29, 6), (20 + steps) * STEP), command, command, 15, lags)
    assert (new != command).all() == moves


def test_continuous_pressures_move_freely():
    """Without the grid to what is needed, to the Pa."""
    new, _ = planner(quantised=False).plan(np.full((29, 6), 12345.6), np.zeros(6), np.zeros(6), 15, LAGS)
    assert new == pytest.approx(12345.6)


@pytest.mark.parametrize("slope", [2e5, -2e5])
def test_pressure_leads_its_lag(slope):
    """Along a ramp, up or down, the pressure in the muscle is where it is needed; a command that is only what is needed lags behind."""
    tested, start = planner(deadband=0.5, slope_window=3), 2.5e5 - 0.5 * slope
    lagging = np.full(6, start)
    pressure, command, off, without = np.full(6, start), np.full(6, start), [], []
    for k in range(50):
        time = STAGE * (k + np.arange(29))
        need = np.repeat((start + slope * time)[:, None], 6, axis=1)
        command, _ = tested.plan(need, command, pressure, 15, LAGS)
        pressure, lagging = DEVICES.lag(pressure, command, STAGE), DEVICES.lag(lagging, need[0], STAGE)
        off.append(np.abs(pressure - need[1]).max())
        without.append(np.abs(lagging - need[1]).max())
    assert max(off[25:]) < 1.5 * STEP
    assert min(without[25:]) > 4 * STEP


def test_reached_pressures_are_what_the_lag_makes_of_the_commands():
    """When nothing changes any more: exponentially to the new command, faster up than down."""
    need = np.tile(np.array([3e5, 1e5, 2e5, 2e5, 2e5, 2e5]), (29, 1))
    new, reached = planner().plan(need, np.full(6, 2e5), np.full(6, 2e5), 15, LAGS)
    passed = STAGE * np.arange(1, 16)
    assert reached[:, 0] == pytest.approx(new[0] + (2e5 - new[0]) * np.exp(-passed / 0.12))
    assert reached[:, 1] == pytest.approx(new[1] + (2e5 - new[1]) * np.exp(-passed / 0.24))


def test_devices_of_the_robot_file_and_of_a_model_with_a_lag_of_its_own():
    """A lag or delay that was identified goes before what the robot file says."""
    assert Devices.from_model(compile_model(NOMINAL, backend="python")) == DEVICES
    known = NOMINAL.with_effect("regulator_lag", filling_time=0.05, exhausting_time=0.3).with_effect("time_delay", delay=0.02)
    assert Devices.from_model(compile_model(known, backend="python")) == Devices(0.05, 0.3, 10.0, 0.02)


def test_devices_of_a_model_whose_lag_has_another_name(monkeypatch):
    """Lags and delays are found by what effects declare, whatever they and their parameters are called."""
    for effect, name in (("regulator_lag", "slow_valves"), ("time_delay", "late_bus")):
        renamed = type("Renamed", (type(find_effect(effect)),), {"name": name})()
        monkeypatch.setitem(_registry(), name, renamed)
    known = NOMINAL.with_effect("slow_valves", filling_time=0.05, exhausting_time=0.3).with_effect("late_bus", delay=0.02)
    model = compile_model(known, backend="python")
    assert Devices.from_model(model) == Devices(0.05, 0.3, 10.0, 0.02)
    assert Devices.from_model(model.with_theta(np.where(model.theta == 0.3, 0.2, model.theta))).exhausting == 0.2
    effects = InputEffects(model, np.append(np.full(6, 2e5), np.full(6, 3.0)))
    actuators = actuators_at(3e5, 3.0)
    effects.advance(actuators, 0.01)
    assert effects.forces == pytest.approx(np.zeros(6), abs=1e-9)


def test_actuators_lag_and_slew():
    """Pressures exponentially, tensions at the motors' rate; F_a at the start and the end; a look ahead changes nothing."""
    actuators = actuators_at(1e5, 2.0)
    actuators.command = Command.from_inputs(np.append(np.full(6, 2e5), np.full(6, 2.05)))
    ahead = actuators.copy()
    before, after = ahead.advance()
    assert before == pytest.approx(AREA * 1e5 - 2.0)
    assert ahead.pressure == pytest.approx(2e5 - 1e5 * np.exp(-0.01 / 0.12))
    assert ahead.tension == pytest.approx(2.05)
    assert after == pytest.approx(AREA * ahead.pressure - 2.05)
    assert actuators.pressure == pytest.approx(1e5)
    actuators.command.tensions[:] = 7.0
    actuators.advance()
    assert actuators.tension == pytest.approx(2.1)
    actuators.command.enabled[0] = False
    actuators.advance()
    assert actuators.tension == pytest.approx([0.0, *[2.2] * 5])


def test_measurements_correct_where_there_are_any():
    """Half-way; NaN and what is not measured change nothing."""
    actuators = actuators_at(1e5, 2.0)
    actuators.correct(Sample(0.0, np.zeros((4, 3)), pressures=np.array([2e5, np.nan, 1e5, 1e5, 1e5, 0.0])), 0.0)
    assert actuators.pressure == pytest.approx([1.5e5, 1e5, 1e5, 1e5, 1e5, 0.5e5])
    assert actuators.tension == pytest.approx(2.0)


def test_what_a_gauge_reads_too_much_is_learned():
    """A dynamometer that reads 0.4 N low: its error is known after some seconds, and the tension is not pulled down by it."""
    actuators = actuators_at(1e5, 2.0)
    low = np.array([0.0, -0.4, 0.0, 0.0, 0.0, 0.0])
    for _ in range(500):
        actuators.advance()
        actuators.correct(Sample(0.0, np.zeros((4, 3)), tensions=np.full(6, 2.0) + low), 0.01)
    assert actuators.tension_offset == pytest.approx(low, abs=0.01)
    assert actuators.tension == pytest.approx(2.0, abs=0.01)


def test_a_motor_that_lags_behind_is_no_gauge_that_errs():
    """What differs for some periods only is believed half-way, as ever: 0.1 s of it are a twentieth of the gauge's."""
    actuators = actuators_at(1e5, 2.0)
    for _ in range(10):
        actuators.advance()
        actuators.correct(Sample(0.0, np.zeros((4, 3)), tensions=np.full(6, 1.6)), 0.01)
    assert np.abs(actuators.tension_offset).max() < 0.05
    assert actuators.tension.max() < 1.8


@pytest.mark.parametrize(("filling", "exhausting"), [(0.03, 0.06), (0.12, 0.24), (0.25, 0.5)])
def test_lags_are_learned_from_monitors(filling: float, exhausting: float) -> None:
    """Regulators 4 times quicker, as declared, twice slower: within 8 % after 3 s of steps, with noise and a monitor
    that reads 5 kPa high."""
    true, random = Devices(filling, exhausting, 10.0, 0.0), np.random.default_rng(3)
    actuators, pressure = actuators_at(1e5, 2.0), np.full(6, 1e5)
    for k in range(300):
        if k % 20 == 0:
            actuators.command = Command.from_inputs(np.append(random.uniform(0.5e5, 4e5, 6), np.full(6, 2.0)))
        pressure = true.lag(pressure, actuators.command.pressures, 0.01)
        actuators.advance()
        actuators.correct(Sample(0.0, np.zeros((4, 3)), pressures=pressure + 5e3 + 500 * random.standard_normal(6)), 0.01)
    shares = 1 - np.exp(-0.01 / np.array([[filling], [exhausting]]))
    assert actuators.lags.shares == pytest.approx(np.repeat(shares, 6, axis=1), rel=0.08)
    quicker = np.array([[0.12 / filling], [0.24 / exhausting]])
    assert actuators.lags.quicker == pytest.approx(np.repeat(quicker, 6, axis=1), rel=0.15)


def test_a_look_ahead_teaches_nothing() -> None:
    """Neither do readings that are not there."""
    actuators = actuators_at(1e5, 2.0)
    actuators.command = Command.from_inputs(np.append(np.full(6, 3e5), np.full(6, 2.0)))
    ahead = actuators.copy()
    for _ in range(20):
        ahead.advance()
        ahead.correct(Sample(0.0, np.zeros((4, 3)), pressures=np.append(np.full(5, 3e5), np.nan)), 0.01)
    assert (ahead.lags.shares[0, :5] > 2 * LAGS.shares[0, :5]).all()
    assert ahead.lags.shares[0, 5] == LAGS.shares[0, 5]
    assert (actuators.lags.shares == LAGS.shares).all()


def test_a_gauge_that_jumps_further_than_a_motor_can_is_not_believed():
    """2 N from one period to the next: at once its own but for half a newton, and the tension is what was commanded."""
    actuators = actuators_at(1e5, 2.0)
    actuators.advance()
    actuators.correct(Sample(0.0, np.zeros((4, 3)), tensions=np.zeros(6)), 0.01)
    assert actuators.tension_offset == pytest.approx(-1.5, abs=0.02)
    assert actuators.tension == pytest.approx(2.0)


def numbered(line: CommandDelayLine, rows: range) -> list[float]:
    """Pressures of the commands in force over periods."""
    return [float(line.command_at(row).pressures[0]) for row in rows]


def test_commands_on_their_way() -> None:
    """Each acts two periods after its sample, from the first sample's time on; those that act no more are forgotten."""
    line = CommandDelayLine(Command.from_inputs(np.zeros(2)), 0.01, 2)
    assert line.take_time(5.0) == 0
    for row in range(20):
        assert line.take_time(5.0 + 0.01 * row) == row
        line.send(5.0 + 0.01 * row, Command.from_inputs(np.array([row + 1.0, 0.0])))
    assert line.last.pressures[0] == 20.0
    assert numbered(line, range(18, 23)) == [17.0, 18.0, 19.0, 20.0, 20.0]
    assert len(line._entries) == MOST_LATE + 3


def test_commands_that_act_later_than_was_thought() -> None:
    """By three periods: sent ones and those to come; never by more than is allowed, nor before a period has passed."""
    line = CommandDelayLine(Command.from_inputs(np.zeros(2)), 0.01, 2)
    line.take_time(0.0)
    line.send(0.0, Command.from_inputs(np.array([1.0, 0.0])))
    line.postpone(3)
    line.send(0.01, Command.from_inputs(np.array([2.0, 0.0])))
    assert numbered(line, range(4, 8)) == [0.0, 1.0, 2.0, 2.0]
    assert line.late == pytest.approx(0.03)
    line.postpone(100)
    assert line.ahead == 2 + MOST_LATE
    line.postpone(-100)
    assert line.ahead == 1


def test_no_effects_no_extra_forces(kang):
    """Of the nominal model, and of one whose only effects are the devices'."""
    inputs = np.append(np.full(6, 2e5), np.full(6, 3.0))
    lagging = compile_model(NOMINAL.with_effect("regulator_lag", filling_time=0.05, exhausting_time=0.3), backend="python")
    for model in (kang, lagging):
        effects = InputEffects(model, inputs)
        actuators = actuators_at(2e5, 3.0)
        actuators.pressure = np.full(6, 3e5)
        effects.advance(actuators, 0.01)
        assert effects.forces == pytest.approx(np.zeros(6), abs=1e-9)


def test_weaker_muscle_lacks_its_share():
    """A tenth of muscle 13's p A, from the start and after a change."""
    model = compile_model(NOMINAL.with_effect("actuator_gain", "13", loss=0.1), backend="python")
    actuators = actuators_at(2e5, 3.0)
    effects = InputEffects(model, np.concatenate([actuators.pressure, actuators.tension]))
    assert effects.forces == pytest.approx([0, 0, -0.1 * AREA * 2e5, 0, 0, 0])
    actuators.pressure = np.full(6, 3e5)
    effects.advance(actuators, 0.01)
    assert effects.forces == pytest.approx([0, 0, -0.1 * AREA * 3e5, 0, 0, 0])


def test_friction_turns_over_within_its_distance():
    """1 − 2 exp(−x / distance) after a reversal, however the way is cut into pieces; at rest it stays."""
    one = dahl_step(np.array([-1.0]), np.array([1e-3]), 5e-4)
    assert one == pytest.approx(1 - 2 * np.exp(-2))
    pieces = dahl_sequence(np.array([-1.0]), np.full((10, 1), 1e-4), 5e-4)
    assert pieces[-1] == pytest.approx(one)
    assert pieces[4] == pytest.approx(dahl_step(np.array([-1.0]), np.array([5e-4]), 5e-4))
    assert dahl_step(np.array([0.3]), np.zeros(1), 5e-4) == 0.3
    assert dahl_sequence(np.array([0.3]), np.zeros((3, 1)), 5e-4)[-1] == pytest.approx(0.3)

"""The closed loop's ends: on rigs that do one thing wrong, each is noticed and the rig is stopped."""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Callable
from dataclasses import replace
from types import TracebackType

import numpy as np
import pytest

from tepm_opt.control import controllers as controllers_module
from tepm_opt.control.baselines.lqg import Lqg
from tepm_opt.control.baselines.modes import LengthFollower
from tepm_opt.control.controller import ControllerKind, NoSettings, Telemetry
from tepm_opt.control.controllers import DEFAULT, controllers, find_controller, register, settings_of
from tepm_opt.control.loop import Guard, LoopRecord, close_loop
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.control.references.reference import Reference
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.hw.simulation.family import random_machine
from tepm_opt.jobs.closed_loop import LoopSetup
from tepm_opt.jobs.mpc import run_closed_loop
from tepm_opt.models.robot import load_robot
from tepm_opt.outcome import Ending
from tepm_opt.plots.control import path_figure
from tests.control.study import disturbed

ROBOT = load_robot("kang2017")
GUARD = Guard(approach_time=0.5, settle_time=0.4)
CLOSED = 0.9  # s after which the loop is closed


class Fake:
    """A rig that is where the reference has the robot, until something is done to its samples.

    Attributes:
        commands: given.
        stopped: how often.
    """

    robot, simulated = ROBOT, None

    def __init__(self, reference: Reference, change: Callable[[float, Sample], Sample] = lambda _, sample: sample) -> None:
        self.reference, self.change, self.now = reference, change, -1
        self.commands: list[Command] = []
        self.stopped = 0

    @property
    def time(self) -> float:
        """Of the last sample in s."""
        return 0.01 * self.now

    def read(self) -> Sample:
        """Ten milliseconds on."""
        self.now += 1
        row = int(self.reference.rows_at(self.now - round(CLOSED / 0.01)))
        sample = Sample(0.01 * self.now, self.reference.equilibria[row].points.copy(), np.zeros(6), np.zeros(6))
        return self.change(0.01 * self.now - CLOSED, sample)

    def apply(self, command: Command) -> None:
        """Keep it."""
        self.commands.append(command)

    def stop(self) -> None:
        """Count it."""
        self.stopped += 1

    def __enter__(self) -> Fake:
        """Itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Stop."""
        self.stop()


class Still:
    """A controller that always wants the same."""

    def __init__(self, reference: Reference) -> None:
        self.reference = reference

    def start(self) -> Command:
        """Half of everything, one motor off."""
        return Command(np.full(6, 2e5), np.full(6, 3.0), np.arange(6) > 0)

    def command(self, sample: Sample) -> Command:
        """Likewise."""
        return self.start()

    def telemetry(self) -> Telemetry:
        """Nothing."""
        return Telemetry()


def blind(now: float, sample: Sample) -> Sample:
    """No points from 1 s on."""
    return replace(sample, points=np.full((4, 3), np.nan)) if now > 1.0 else sample


def astray(now: float, sample: Sample) -> Sample:
    """All points half a metre off from 1 s on."""
    return replace(sample, points=sample.points + 0.5 * (now > 1.0))


def strained(now: float, sample: Sample) -> Sample:
    """A tension beyond its limit from 1 s on."""
    tensions = np.zeros(6)
    tensions[4] = 7.5 if now > 1.0 else 7.3
    return replace(sample, tensions=tensions)


def burst(now: float, sample: Sample) -> Sample:
    """A pressure beyond its limit from 1 s on, on a board that measures no tensions."""
    return replace(sample, pressures=np.full(6, 6e5 if now > 1.0 else 5e5), tensions=None)


def torn(now: float, sample: Sample) -> Sample:
    """One pressure is no number from 1 s on."""
    pressures = np.full(6, 1e5)
    pressures[3] = np.nan if now > 1.0 else 1e5
    return replace(sample, pressures=pressures)


def silent(now: float, sample: Sample) -> Sample:
    """Nothing is measured from 1 s on, but for the points."""
    return replace(sample, pressures=None, tensions=None) if now > 1.0 else sample


def tipless(now: float, sample: Sample) -> Sample:
    """The tip is lost for good after 1 s, the other points are not."""
    points = sample.points.copy()
    points[-1] = np.nan if now > 1.0 else points[-1]
    return replace(sample, points=points)


def flickering(now: float, sample: Sample) -> Sample:
    """All points half a metre off from 1 s on, and the tip lost in every second sample."""
    points = sample.points + 0.5 * (now > 1.0)
    points[-1] = np.nan if round(now / 0.01) % 2 else points[-1]
    return replace(sample, points=points)


def over(now: float, sample: Sample) -> Sample:
    """The recording ends after 1 s."""
    if now > 1.0:
        raise EOFError("no more samples")
    return sample


def interrupted(now: float, sample: Sample) -> Sample:
    """Ctrl-C after 1 s."""
    if now > 1.0:
        raise KeyboardInterrupt
    return sample


def broken(now: float, sample: Sample) -> Sample:
    """The line is cut after 1 s."""
    if now > 1.0:
        raise OSError("the cable is out")
    return sample


def test_reference_is_followed_to_its_end(short):
    """Every period once, after a glide to the start from nothing; in the end slowly back to nothing, and the rig is stopped."""
    rig = Fake(short)
    done = close_loop(rig, Still(short), ROBOT, GUARD)
    assert done.outcome.ending is Ending.DONE
    assert done.rows == list(range(len(short)))
    assert done.time[-1] == pytest.approx(short.duration)
    assert done.error(False) == pytest.approx(0.0, abs=1e-9)
    assert np.isnan(done.error())
    assert done.counted.sum() == 100
    glide = np.array([command.pressures[0] for command in rig.commands[:80]])
    assert glide[0] == 0
    assert (np.diff(glide) >= 0).all()
    assert np.diff(glide).max() < 2e5 * 1.875 * 0.01 / 0.5 * 1.01
    assert glide[-1] == pytest.approx(2e5)
    assert all(command.tensions[0] == 0 for command in rig.commands[:80])  # of a motor that is off
    back = np.array([command.pressures[0] for command in rig.commands[-50:]])
    assert (np.diff(back) <= 0).all()
    assert np.diff(back).min() > -2e5 * 1.875 * 0.01 / 0.5 * 1.01
    assert back[-1] < 0.01 * back[0]
    assert rig.stopped == 1


def test_rig_that_rests_at_the_start_is_not_taken_there(short):
    """Without a glide the first command is the start, and the first sample closes the loop."""
    rig = Fake(short)
    rig.now = round(CLOSED / 0.01) - 1
    done = close_loop(rig, Still(short), ROBOT, replace(GUARD, approach_time=0.0))
    assert done.outcome.ending is Ending.DONE
    assert done.rows == list(range(len(short)))
    assert (rig.commands[0].pressures == 2e5).all()
    assert len(rig.commands) == 1 + len(short)
    assert rig.stopped == 1


@pytest.mark.parametrize(
    ("change", "ending", "at", "says"),
    [
        (blind, Ending.BLIND, 1.2, "no tracked point for 0.2 s"),
        (astray, Ending.DISAGREED, 1.5, "more than 200 mm off"),
        (strained, Ending.LIMIT, 1.0, "tension_22"),
        (burst, Ending.LIMIT, 1.0, "measured pressure_11 is 120 % of its limit"),
        (torn, Ending.UNMEASURED, 1.2, "pressure_21 was not measured for 0.2 s"),
        (silent, Ending.UNMEASURED, 1.2, "pressure_11 was not measured for 0.2 s"),
        (tipless, Ending.BLIND, 2.0, "the tip was not tracked for 1 s"),
        (flickering, Ending.DISAGREED, 1.5, "more than 200 mm off"),
        (over, Ending.OVER, 1.0, "no more samples"),
        (interrupted, Ending.INTERRUPTED, 1.0, "by the user"),
    ],
)
def test_ends(short, change, ending, at, says):
    """Each with its reason, in time, with what was done until then and the rig stopped."""
    rig = Fake(short, change)
    done = close_loop(rig, Still(short), ROBOT, GUARD)
    assert done.outcome.ending is ending
    assert says in done.outcome.message
    assert done.time[-1] == pytest.approx(at, abs=0.03)
    assert rig.stopped == 1


@pytest.mark.parametrize(
    ("change", "limits", "ending", "at"),
    [
        (blind, {"tracking_timeout": 0.4}, Ending.BLIND, 1.4),
        (tipless, {"tip_timeout": 0.4}, Ending.BLIND, 1.4),
        (astray, {"error_timeout": 0.2}, Ending.DISAGREED, 1.2),
        (astray, {"largest_error": 1.0}, Ending.DONE, 4.49),  # it is 0.87 m off
        (strained, {"limit_margin": 0.1}, Ending.DONE, 4.49),  # 7.5 N of 7 N
    ],
)
def test_limits_of_the_guard(short, change, limits, ending, at):
    """Each one alone decides when its trouble ends the loop, or that it does not."""
    done = close_loop(Fake(short, change), Still(short), ROBOT, replace(GUARD, **limits))
    assert done.outcome.ending is ending
    assert done.time[-1] == pytest.approx(at, abs=0.03)


@pytest.mark.parametrize("tolerance", [0.09, 0.11])
def test_start_may_be_off_by_its_tolerance(short, tolerance):
    """Tracked 100 mm beside the model's."""
    rig = Fake(short, lambda now, sample: replace(sample, points=sample.points + np.array([0.1, 0, 0])))
    kept = LoopRecord(short)
    with pytest.raises(InputError, match="100 mm") if tolerance < 0.1 else contextlib.nullcontext():
        close_loop(rig, Still(short), ROBOT, replace(GUARD, start_tolerance=tolerance), keep=kept)
    assert len(kept.rows) == (0 if tolerance < 0.1 else len(short))


@pytest.mark.parametrize("change", [broken, lambda now, sample: replace(sample, points=sample.points[:3])])
def test_rig_is_stopped_whatever_is_raised(short, change):
    """And what was done until then is kept."""
    rig, kept = Fake(short, change), LoopRecord(short)
    with pytest.raises((OSError, InputError)):
        close_loop(rig, Still(short), ROBOT, GUARD, keep=kept)
    assert rig.stopped == 1
    assert len(kept.rows) == (101 if change is broken else 0)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda now, sample: replace(sample, points=sample.points + np.array([0.1, 0, 0])), "miss the model's by 100 mm"),
        (lambda now, sample: replace(sample, points=np.full((4, 3), np.nan)), "sees nothing"),
    ],
)
@pytest.mark.filterwarnings("ignore:Mean of empty slice")
def test_start_that_disagrees_is_refused(short, change, says):
    """Before the loop is closed: nothing but the glide was sent."""
    rig, kept = Fake(short, change), LoopRecord(short)
    with pytest.raises(InputError, match=says):
        close_loop(rig, Still(short), ROBOT, GUARD, keep=kept)
    assert not kept.rows
    assert rig.stopped == 1


def test_short_trouble_is_no_reason_to_stop(short):
    """0.15 s without points, 0.3 s off by half a metre, one point lost for good."""

    def change(now: float, sample: Sample) -> Sample:
        points = sample.points + 0.5 * (2.0 < now < 2.3)
        points[1] = np.nan
        return replace(sample, points=np.full((4, 3), np.nan) if 1.0 < now < 1.15 else points)

    assert close_loop(Fake(short, change), Still(short), ROBOT, GUARD).outcome.ending is Ending.DONE


def test_faster_rig_gets_a_command_a_period(short):
    """Two frames a period: every row is there once all the same; a slower rig leaves rows out."""
    for factor, rows in ((0.5, list(range(450))), (2.0, list(range(0, 450, 2)))):
        rig = Fake(short, lambda now, sample, factor=factor: replace(sample, time=factor * sample.time))
        assert close_loop(rig, Still(short), ROBOT, replace(GUARD, largest_error=np.inf)).rows == rows


def test_measured_inputs_observer_and_progress(short):
    """Rows of measured inputs where both are measured, and everybody who wants to see is told."""
    told, seen = [], []
    rig = Fake(short)
    done = close_loop(rig, Still(short), ROBOT, GUARD, lambda *what: told.append(what), lambda sample, target: seen.append(target))
    assert np.array(done.measured).shape == (450, 12)
    assert {stage for stage, _, _ in told} == {"to the start", "tracking", "back to zero"}
    np.testing.assert_array_equal(seen, short.tips)
    without = close_loop(Fake(short, lambda _, sample: replace(sample, tensions=None)), Still(short), ROBOT, GUARD)
    assert np.isnan(without.measured).all()


@pytest.mark.slow
def test_controllers_by_name(kang, short):
    """The four of them, the default one first, and nothing else."""
    kinds = {kind.name: type(kind.make(kang, short, kind.settings({}))) for kind in controllers()}
    assert list(kinds.items()) == [(DEFAULT, Mpc), ("lqg", Lqg), ("mode1", LengthFollower), ("mode2", LengthFollower)]
    with pytest.raises(InputError, match="mode3"):
        find_controller("mode3")
    with pytest.raises(InputError, match="MpcSettings"):
        find_controller("mpc").make(kang, short, NoSettings())


def test_a_controller_of_ones_own(kang, short):
    """Registered, it is set up, runs, logs and is drawn by its name like the others; no other file knows of it."""

    class Counting(Still):
        count = 0

        def command(self, sample: Sample) -> Command:
            """As ever, counted."""
            self.count += 1
            return self.start()

        def telemetry(self) -> Telemetry:
            """How often it was asked."""
            return Telemetry({"asked": float(self.count), "mood": "calm"}, {"bored": self.count // 100})

    kind = ControllerKind("counting", "Counting", "counting controller", lambda model, reference, settings: Counting(reference))
    register(kind)
    try:
        with pytest.raises(InputError, match="exists already"):
            register(kind)
        with pytest.raises(InputError, match="--use belongs to the predictive controller; leave it out with --controller counting"):
            settings_of(kind, {"use": "tension"})
        with pytest.raises(InputError, match="unknown option 'rule': valid: use"):
            settings_of(find_controller(DEFAULT), {"rule": True})
        setup = LoopSetup.from_options("counting", "fake", 0, {})
        loop = run_closed_loop(kang, short, Fake(short), setup, guard=GUARD)
        assert loop.ok
        told = loop.summary()
        assert (told["controller"], told["settings"], told["fallbacks"]) == ("counting", {}, {"bored": 4})
        columns = loop.columns()
        np.testing.assert_array_equal(columns["asked"], np.arange(1, 451))
        assert set(columns["mood"]) == {"calm"}
        assert any("Counting" in text.get_text() for text in path_figure({"one": loop}).axes[0].get_legend().get_texts())
    finally:
        registry = controllers_module._registry()
        registry.pop("counting")


@pytest.mark.parametrize("change", [lambda time, sample: sample, lambda time, sample: 1 / (time < 0.1) and sample])
def test_nothing_is_collected_while_the_loop_is_closed(short, change):
    """Python's collector pauses; it is on again afterwards, whatever is raised."""
    seen = []

    def noted(time: float, sample: Sample) -> Sample:
        seen.append(gc.isenabled())
        return change(time, sample)

    with contextlib.suppress(ZeroDivisionError):
        close_loop(Fake(short, noted), Still(short), ROBOT, GUARD)
    assert len(seen) > 50
    assert not any(seen)
    assert gc.isenabled()


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 8])
def test_arm_stays_near_its_target_without_the_tip(number: int) -> None:
    """Random machines that hold a point: 2.0 and 1.6 mm when written; 6.4 and 5.7 mm with the noise model of a tip that is seen."""
    assert disturbed("dead4", 1, file=random_machine("kang2017", 60501, number))["after"] < 4.0

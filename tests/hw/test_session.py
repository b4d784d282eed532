"""The rig's imperfections that go on in a session's time: closed forms, and rigs that start late in it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import RigFile

STEP = 1 / 4000


def rig_of(began: float = 0.0, **imperfections: Any) -> SimulatedRig:
    """A rig without noise that starts at a time in the session."""
    file = {"name": "test", "robot": "kang2017", "simulation": {"step_s": STEP}, "tracker": {"rate_hz": 50}, "imperfections": imperfections}
    rig = SimulatedRig(RigFile.model_validate(file))
    rig.reseed(0, began)
    return rig


def seen(rig: SimulatedRig, frames: int = 60) -> np.ndarray:
    """Points (frames, 4, 3) in m while pressures and tensions rise."""
    time = np.arange(frames) * 0.02
    wave = 0.5 - 0.5 * np.cos(4 * time)
    inputs = np.outer(wave, np.repeat([1e5, 3.0], 6) * np.tile([1.0, 0.3, 0.6], 4))
    rig.schedule(SetPoints(time, inputs, np.zeros((frames, 3))))
    return np.array([sample.points for sample in rig.read_many(frames)])


@pytest.fixture(scope="module")
def plain() -> np.ndarray:
    return seen(rig_of())


def test_a_session_s_time_means_nothing_without_them(plain):
    np.testing.assert_array_equal(seen(rig_of(began=500.0)), plain)


def test_a_drift_is_a_sine_of_the_session_s_time(plain):
    found = seen(rig_of(began=100.0, tracker_drift={"shift_m": [0.01, 0, 0], "period_s": 1000.0}))
    time = 100.0 + 0.02 * np.arange(len(plain))
    np.testing.assert_allclose(found[:, :, 0] - plain[:, :, 0], 0.01 * np.sin(2 * np.pi * time / 1000)[:, None] * np.ones(4), atol=1e-12)


@pytest.mark.parametrize(("began", "share"), [(0.0, 0.0), (5.0, 0.25), (30.0, 0.5)])
def test_muscles_warm_in_proportion_to_time_and_stay_warm(began, share):
    """A stretch of 10 mm is held by less: by a share of what the muscles' own springs hold."""
    rig = rig_of(began=began, warm_up={"change": -0.5, "full_s": 10.0})
    stage = next(stage for stage in rig.machine.edges if hasattr(stage, "clock"))
    rig.read()
    stretched = stage.rest + 0.01
    np.testing.assert_allclose(stage.settle(stretched), share * rig.machine.body.stiffness[:, :3] * 0.01, rtol=1e-12)


def test_a_tendon_that_has_slipped_pulls_less_and_one_that_will_does_not(plain):
    slip = {"share": {"13": 0.5}, "instant_s": 50.0}
    np.testing.assert_allclose(seen(rig_of(began=0.0, tendon_slip=slip)), plain, atol=1e-12)
    late, amid = seen(rig_of(began=60.0, tendon_slip=slip)), seen(rig_of(began=49.5, tendon_slip=slip))
    weaker = seen(rig_of(tension_gain={"loss": {"13": 0.5}}))
    np.testing.assert_allclose(late, weaker, atol=1e-9)
    assert abs(late - plain).max() > 1e-3
    np.testing.assert_allclose(amid[:25], plain[:25], atol=1e-12)
    assert abs(amid[30:] - plain[30:]).max() > 1e-3


def test_frames_of_a_fast_clock_are_older_than_they_say(plain):
    """1 % in 1.18 s: 11.8 ms at the last frame, whose speed says how far it was from there."""
    found = seen(rig_of(clock_skew={"rate": 0.01}))
    speed = np.gradient(plain, 0.02, axis=0)
    time = 0.02 * np.arange(len(plain))[:, None, None]
    expected = -0.01 * time * speed
    assert abs(found - plain - expected).max() < 0.05 * abs(expected).max() + 0.5 * STEP * abs(speed).max()
    assert abs(expected).max() > 1e-3


def test_jitter_is_drawn_anew_for_every_frame_and_run(plain):
    jitter = {"up_to_s": 0.01}
    rigs = [rig_of(sample_jitter=jitter) for _ in range(3)]
    rigs[2].reseed(1)
    first, same, other = (seen(rig) for rig in rigs)
    np.testing.assert_array_equal(first, same)
    assert abs(first - other).max() > 1e-4
    speed = np.gradient(plain, 0.02, axis=0)
    ages = -((first - plain) * speed).sum(axis=(1, 2)) / (speed**2).sum(axis=(1, 2))
    moving = ages[5:]
    assert moving.min() >= -1e-3
    assert moving.max() <= 0.011
    assert moving.mean() == pytest.approx(0.005, abs=1.5e-3)


def test_a_base_that_moves_slowly_carries_the_robot_and_a_fast_one_leaves_the_tip_behind():
    """Amplitude at the tip over the base's, in the tracker's frame: above the sway's frequency masses stay where they are in space."""
    for frequency, low, high in ((0.15, 0.9, 1.3), (20.0, 0.0, 0.4)):
        rig = rig_of(base_vibration={"amplitude_m": [1e-3, 0, 0], "frequency_Hz": frequency, "harmonic": 0.0})
        rig.schedule(SetPoints(np.array([0.0, 8.0]), np.zeros((2, 12)), np.zeros((2, 3))))
        tip = np.array([sample.points for sample in rig.read_many(400)])[100:, -1, 0]
        assert low < (np.ptp(tip) / 2e-3) < high, frequency
    stand = rig_of(base_vibration={"amplitude_m": [1e-3, 0, 0], "frequency_Hz": 20.0, "harmonic": 0.0, "felt": False})
    stand.schedule(SetPoints(np.array([0.0, 8.0]), np.zeros((2, 12)), np.zeros((2, 3))))
    x = np.array([sample.points for sample in stand.read_many(400)])[:, :, 0]
    np.testing.assert_allclose(np.ptp(x, axis=0), 2e-3, rtol=0.1)

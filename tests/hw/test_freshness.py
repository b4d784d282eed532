"""Measurements that are none: no false alarm over honest noise on any grid; what repeats or is exchanged is told in time by its name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tepm_opt.hw.freshness import LEAST_REPEATS, DeclaredNoise, FreshnessMonitor, chance_of_repeat, repeats_until_stale
from tepm_opt.hw.guard import STALE_S, Stopped, Watch
from tepm_opt.hw.rig import Sample
from tepm_opt.hw.simulation.devices import on_grid
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import load_robot
from tepm_opt.outcome import Ending

ROBOT = load_robot("kang2017")
LAYOUT, LIMITS, RATE = Layout.from_robot(ROBOT), ROBOT.input_max, 100.0
PLACES = np.array([[0.0, 0, 0.1], [0.01, 0, 0.2], [0.02, 0.01, 0.3], [0.03, 0.02, 0.4]])
NOISE = DeclaredNoise(point=5.8e-4, pressure=500.0, tension=0.01, point_grid=0.0)


def monitor(noise: DeclaredNoise = NOISE) -> FreshnessMonitor:
    """One of the robot."""
    return FreshnessMonitor(LAYOUT, LIMITS, noise, RATE)


def samples(count: int, noise: DeclaredNoise = NOISE, seed: int = 0) -> list[Sample]:
    """An arm and gauges at rest, with the noise on the grids declared."""
    random = np.random.default_rng(seed)
    found = []
    for k in range(count):
        points = on_grid(PLACES + noise.point * random.normal(size=PLACES.shape), noise.point_grid)
        pressures = on_grid(2e5 + noise.pressure * random.normal(size=6), noise.pressure_grid)
        tensions = on_grid(3.0 + noise.tension * random.normal(size=6), noise.tension_grid)
        found.append(Sample(k / RATE, points, pressures, tensions))
    return found


@pytest.mark.parametrize("width", [0.1, 0.5, 1.0, 2.0, 5.0])
def test_the_chance_of_a_repeat(width):
    """Of one more after repeats: as drawn for a value in the middle of a cell; no row of repeats is likelier, wherever the value is."""
    random, chance = np.random.default_rng(1), chance_of_repeat(1.0, width)
    for place in (0.0, 0.25, 0.5):
        values = np.round((random.normal(size=(7, 200_000)) + place * width) / width)
        rows = [float((values[: n + 1] == values[0]).all(axis=0).mean()) for n in range(7)]
        assert all(row <= chance**n + 4 * np.sqrt(chance**n / 2e5) for n, row in enumerate(rows))
        if place == 0 and rows[6] > 1e-3:
            assert rows[6] / rows[5] == pytest.approx(chance, rel=0.1)


def test_no_noise_is_not_judged():
    """A channel without noise always repeats, one on no grid never does."""
    assert chance_of_repeat(0.0, 1.0) == 1.0
    assert chance_of_repeat(1.0, 0.0) == 0.0
    assert repeats_until_stale(1.0, RATE) is None
    assert repeats_until_stale(0.9, RATE) is None  # more than half a second would be needed
    assert repeats_until_stale(0.0, RATE) == LEAST_REPEATS
    assert 0.5 ** repeats_until_stale(0.5, RATE) * RATE * 3.6e6 < 1 < 0.5 ** (repeats_until_stale(0.5, RATE) - 2) * RATE * 3.6e6


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.02, 0.3, 1.0, 2.0, 6.0, 50.0]))
def test_no_false_alarm_over_noise(seed, width):
    """Grids from none to fifty sigmas, where all readings repeat: nothing is told, and no more than single honest repeats are withheld."""
    noise = replace(NOISE, point_grid=width * NOISE.point, pressure_grid=width * NOISE.pressure, tension_grid=width * NOISE.tension)
    watch, commands = monitor(noise), np.concatenate([np.full(6, 2e5), np.full(6, 3.0)])
    withheld = 0
    for sample in samples(600, noise, seed):
        given = watch.look(sample, commands)
        assert not given.faults
        assert np.isfinite(given.pressures).all()
        withheld += len(given.stale)
    assert withheld <= 12  # a thousandth of 2400 poses is 2.4 on average


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(["tracker", "s1", "s4", "pressure", "tension"]), st.sampled_from([0.0, 0.1, 1.0]))
def test_a_freeze_is_told_in_time(seed, what, width):
    """Within the number of repeats that is computed, by its name; it is withheld, and given again once it changes."""
    noise = replace(NOISE, point_grid=width * NOISE.point, pressure_grid=width * NOISE.pressure, tension_grid=width * NOISE.tension)
    every, watch = samples(160, noise, seed), monitor(noise)
    one = {"pressure": noise.pressure, "tension": noise.tension}.get(what, noise.point)
    grid = {"pressure": noise.pressure_grid, "tension": noise.tension_grid}.get(what, noise.point_grid)
    axes = {"tracker": 12, "pressure": 1, "tension": 1}.get(what, 3)
    needed = repeats_until_stale(chance_of_repeat(one, grid) ** axes, RATE)
    assert needed is not None
    held, names = every[59], {"tracker": "tracker", "pressure": "pressure gauge 13", "tension": "dynamometer 21"}
    name = f"{names.get(what, what)} frozen"
    for k, sample in enumerate(every):
        if 60 <= k < 140:
            points, pressures, tensions = sample.points.copy(), sample.pressures.copy(), sample.tensions.copy()
            which = slice(None) if what == "tracker" else slice(int(what[1]) - 1, int(what[1])) if what[0] == "s" else slice(0)
            points[which] = held.points[which]
            pressures[2] = held.pressures[2] if what == "pressure" else pressures[2]
            tensions[3] = held.tensions[3] if what == "tension" else tensions[3]
            sample = replace(sample, points=points, pressures=pressures, tensions=tensions)
        given = watch.look(sample)
        if k < 60 or k > 145:
            assert not given.faults
        elif 59 + needed <= k < 140:
            assert name in given.faults
            assert name in given.status
            lost = np.isnan(given.points).all(axis=1)
            assert lost.all() if what == "tracker" else lost.any() == (what[0] == "s")
            assert np.isnan(given.pressures[2]) == (what == "pressure")
            assert np.isnan(given.tensions[3]) == (what == "tension")


def test_every_second_frame_repeats():
    """Repeated frames are lost, the others are not; told within 0.3 s with the rate."""
    every, watch, told = samples(100), monitor(), []
    for k, sample in enumerate(every):
        given = watch.look(sample if k < 50 or k % 2 else replace(sample, points=every[k - 1].points))
        assert np.isnan(given.points).all() == (k >= 50 and k % 2 == 0)
        told += [k] * ("tracker repeats frames" in given.faults)
    assert 50 < told[0] <= 80
    assert "tracker repeats 50 % of its frames" in given.faults["tracker repeats frames"]


@pytest.mark.parametrize(("i", "j"), [(0, 1), (1, 2), (2, 3), (0, 3)])
def test_a_swap(i, j):
    """Told at once, neither point is used until they are exchanged back."""
    watch, name = monitor(), f"s{i + 1} and s{j + 1} are swapped"
    for k, sample in enumerate(samples(120)):
        order = np.arange(4)
        if 40 <= k < 80:
            order[[i, j]] = order[[j, i]]
        given = watch.look(replace(sample, points=sample.points[order]))
        assert list(given.faults) == ([name] if 40 <= k < 80 else [])
        assert np.flatnonzero(np.isnan(given.points).any(axis=1)).tolist() == ([i, j] if 40 <= k < 80 else [])


def test_a_gauge_without_noise_is_judged_by_its_command():
    """It stands still for as long as its command does; not told while the command moves by little, or before its lag."""
    noise, first = DeclaredNoise(), samples(1)[0]
    watch = monitor(noise)
    for k in range(300):
        given = watch.look(replace(first, time=k / RATE, points=PLACES + k * 1e-6), np.concatenate([np.full(6, 2e5), np.full(6, 3.0)]))
        assert not given.faults
    for k in range(300, 400):
        commands = np.concatenate([np.full(6, 3e5), np.full(6, 3.0)])
        given = watch.look(replace(first, time=k / RATE, points=PLACES + k * 1e-6), commands)
        assert bool(given.faults) == (k > 350)
    assert set(given.faults) == {f"pressure gauge {name} frozen" for name in LAYOUT.actuator_names}


def checked(every: list[Sample]) -> None:
    """Look at samples one after the other, as a loop does."""
    watch, guard = monitor(), Watch(LAYOUT.actuator_names, LIMITS)
    for sample in every:
        guard.check(watch.look(sample))


def with_frozen(name: str, which: int, count: int) -> list[Sample]:
    """Samples in which one point or gauge is frozen from 0.5 s on."""
    every, found = samples(count), []
    for sample in every:
        values = getattr(sample, name).copy()
        values[which] = getattr(every[50], name)[which] if sample.time > 0.5 else values[which]
        found.append(replace(sample, **{name: values}))
    return found


def test_a_stale_tip_stops_the_rig():
    """After 0.2 s, not before, with the cause."""
    checked(with_frozen("points", 3, round((0.5 + STALE_S) * RATE)))
    with pytest.raises(Stopped, match=r"s4 frozen: no fresh pose of the tip for 0\.2 s") as stopped:
        checked(with_frozen("points", 3, round((0.5 + STALE_S) * RATE) + 3))
    assert stopped.value.outcome.ending is Ending.BLIND
    checked(with_frozen("points", 1, 200))


def test_a_frozen_gauge_is_named():
    """The guard says which gauge is frozen."""
    with pytest.raises(Stopped, match=r"dynamometer 21 frozen: tension_21 was not measured for 0\.2 s"):
        checked(with_frozen("tensions", 3, 200))

"""Where a model misses: found where an error is put in, silent where there is only noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tepm_opt.data.channels import Channels
from tepm_opt.data.run import Run
from tepm_opt.discrepancy.assessment.residual_locations import Localisation, localise
from tepm_opt.discrepancy.assessment.result import Place

NOISE = 3e-4  # m
RATE = 50.0  # Hz
CHANNELS = Channels(("11", "12", "13", "21", "22", "23"), ("s1", "s2", "s3", "s4"), pressure_max=5e5, tension_max=7.0)
Change = Callable[[Run], None]


def modelled_runs(seconds: float = 64.0) -> list[Run]:
    """Each of six muscles up and down in turn, in another order in every run, then a rest; points that follow."""
    time = np.arange(round(seconds * RATE) + 1) / RATE
    length = seconds / 8
    runs = []
    for number, order in enumerate(([0, 1, 2, 3, 4, 5], [3, 2, 5, 0, 4, 1], [5, 4, 1, 2, 0, 3])):
        inputs = np.zeros((len(time), 12))
        for turn, muscle in enumerate(order):
            inputs[:, muscle] = 2e5 * np.interp(time, np.array([turn, turn + 0.3, turn + 0.7, turn + 1.0]) * length, [0, 1, 1, 0])
        inputs[:, 6 + number] = np.where(time > 6 * length, 5.0, 0.0)
        reach = inputs[:, :6] @ np.random.default_rng(number).normal(size=(6, 12)) * 2e-7
        points = reach.reshape(-1, 4, 3) * np.arange(1, 5)[:, None] + np.array([0, 0, 0.1]) * np.arange(1, 5)[:, None]
        runs.append(Run(f"run_{number}.csv", "fit", time, inputs, np.zeros((len(time), 3)), points))
    return runs


def found(*changes: Change, runs: list[Run] | None = None, seed: int = 1, noise: float = NOISE, static: bool = False) -> Localisation:
    """What is said of noisy measurements, changed in place."""
    modelled, random = runs or modelled_runs(), np.random.default_rng(seed)
    measured = [replace(run, points=run.points + random.normal(0.0, NOISE, run.points.shape)) for run in modelled]
    for run in measured:
        for change in changes:
            change(run)
    return localise(measured, [run.points for run in modelled], noise, CHANNELS.signals, static, seed=3)


def place(localisation: Localisation, by: str, name: str) -> Place:
    return next(place for place in localisation.places if (place.by, place.name) == (by, name))


def telling(localisation: Localisation) -> set[tuple[str, str]]:
    return {(place.by, place.name) for place in localisation.places[: localisation.telling]}


def while_13(run: Run) -> None:
    """An error of 3 mm of s3 along y in one run while muscle 13 has pressure."""
    if run.file == "run_1.csv":
        run.points[run.inputs[:, 2] > 1e4, 2, 1] += 3e-3


def a_third_missing(run: Run) -> None:
    run.points[np.random.default_rng(run.rows).random(run.points.shape) < 0.33] = np.nan


@pytest.mark.parametrize("more", [(), (a_third_missing,)], ids=["complete", "samples missing"])
def test_finds_run_point_axis_and_actuator(more: tuple[Change, ...]) -> None:
    localisation = found(while_13, *more)
    expected = {("run", "run_1.csv"), ("point", "s3"), ("axis", "y"), ("actuator", "13 pressure")}
    assert expected <= telling(localisation)
    assert all(place(localisation, *key).p < 0.01 for key in expected)
    others = {key for key in telling(localisation) if key[0] in ("run", "point", "axis", "actuator")} - expected
    assert others <= {("actuator", "13 pressure, no other")}
    assert all(place(localisation, *key).share > 0.9 for key in expected)
    assert all(word in localisation.sentence for word in ("run_1.csv", "s3", "along y", "13's pressure"))


def test_an_actuator_is_named_only_where_it_stands_out() -> None:
    """With an error under all tensions alike it is tensions that are in use, not one of them."""

    def under_tension(run: Run) -> None:
        run.points[run.inputs[:, 6:].max(axis=1) > 0.5, 2, 1] += 3e-3

    localisation = found(under_tension)
    assert {("actuator", f"{name} tension") for name in ("11", "12", "13")} <= telling(localisation)
    assert "while tensions are in use" in localisation.sentence
    assert "'s tension" not in localisation.sentence


def test_sizes_have_the_noise_taken_off() -> None:
    localisation = found(while_13)
    run = modelled_runs()[1]
    there = 3e-3 * np.sqrt(np.mean(run.inputs[:, 2] > 1e4))
    assert localisation.heat[1, 2] == pytest.approx(there, rel=0.02)
    assert np.delete(localisation.heat.ravel(), 6).max() < 0.3 * np.sqrt(3) * NOISE
    assert place(localisation, "axis", "y").rms == pytest.approx(localisation.rms, rel=0.02)
    assert localisation.rms == pytest.approx(there / np.sqrt(12), rel=0.05)
    assert (localisation.runs, localisation.points) == (("run_0.csv", "run_1.csv", "run_2.csv"), CHANNELS.points)


@pytest.mark.parametrize("seed", range(5))
def test_silent_on_noise(seed: int) -> None:
    localisation = found(seed=seed)
    assert localisation.telling == 0
    assert localisation.sentence.startswith("No structure above the noise")
    assert localisation.rms < 0.2 * NOISE


def test_one_assumed_noise_for_all_is_an_error_everywhere() -> None:
    localisation = found(noise=0.8 * NOISE)
    assert localisation.telling == 0
    assert "misses by 0.3" in localisation.sentence


def test_too_much_noise_assumed_hides_nothing_large() -> None:
    assert ("run", "run_1.csv") in telling(found(while_13, noise=1.3 * NOISE))


def test_same_answer_twice() -> None:
    first, second = found(while_13), found(while_13)
    assert first.places == second.places
    assert first.sentence == second.sentence


def test_frequency_bands() -> None:
    def sway(run: Run) -> None:
        run.points[:] += 1e-3 * np.sin(2 * np.pi * 0.9 * run.time)[:, None, None]

    def offset(run: Run) -> None:
        run.points[:, 3] += 1e-3

    assert place(found(sway), "band", "0.3 to 2 Hz").share > 0.95
    assert place(found(offset), "band", "below 0.3 Hz").share > 0.95
    assert not [key for key in telling(found(sway)) if key[0] in ("run", "actuator", "regime", "time")]


@pytest.mark.slow
def test_regimes_and_time() -> None:
    def after_reversals(run: Run) -> None:
        speed = np.sign(np.diff(run.inputs[:, :6], axis=0, prepend=run.inputs[:1, :6])).sum(axis=1)
        run.points[:, 3, 2] += np.where(speed < 0, 2e-3, 0.0)

    def at_rest(run: Run) -> None:
        run.points[run.time > 50.5] += 1e-3

    assert {("regime", "high tension"), ("regime", "at rest"), ("time", "late")} <= telling(found(at_rest))
    assert "more at rest" in found(at_rest).sentence
    assert place(found(after_reversals), "regime", "moving").p < 0.01
    assert place(found(after_reversals), "regime", "after a reversal").ratio > 1.25


def test_equilibria_have_no_places_in_time() -> None:
    runs = [
        replace(run, time=np.full(len(rows), np.nan), inputs=run.inputs[rows], tip_force=run.tip_force[rows], points=run.points[rows])
        for run in modelled_runs()
        for rows in [np.arange(0, run.rows, 50)]
    ]
    localisation = found(while_13, runs=runs, static=True)
    assert {("run", "run_1.csv"), ("point", "s3"), ("axis", "y"), ("actuator", "13 pressure")} <= telling(localisation)
    names = {(place.by, place.name) for place in localisation.places}
    assert not {by for by, _ in names} & {"time", "band"}
    assert {name for by, name in names if by == "regime"} <= {"low pressure", "high tension"}


def test_a_point_and_a_run_never_measured() -> None:
    def gone(run: Run) -> None:
        run.points[:, 1] = np.nan
        if run.file == "run_2.csv":
            run.points[:] = np.nan

    localisation = found(while_13, gone)
    assert np.isnan(localisation.heat[2]).all()
    assert np.isnan(localisation.heat[:, 1]).all()
    assert ("point", "s3") in telling(localisation)
    assert ("run", "run_2.csv") not in {(place.by, place.name) for place in localisation.places}


def test_nothing_measured() -> None:
    def gone(run: Run) -> None:
        run.points[:] = np.nan

    localisation = found(gone)
    assert localisation.places == ()
    assert "No sample" in localisation.sentence


def test_exact_agreement_without_noise() -> None:
    runs = modelled_runs()
    localisation = localise(runs, [run.points for run in runs], 0.0, CHANNELS.signals, False, 0)
    assert localisation.telling == 0
    assert localisation.rms == 0.0
    assert localisation.sentence.startswith("No structure")


def test_ranges_unknown() -> None:
    unknown = Channels(CHANNELS.actuators, CHANNELS.points)
    runs = modelled_runs()
    measured = [replace(run, points=run.points + np.where(run.inputs[:, 4] > 1e4, 2e-3, 0.0)[:, None, None]) for run in runs]
    localisation = localise(measured, [run.points for run in runs], NOISE, unknown.signals, False, 0)
    assert ("actuator", "22 pressure") in telling(localisation)

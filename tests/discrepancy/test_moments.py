"""Errors that are local in time: a model misses for a moment, as if something had happened that nobody noted."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.data.run import Run
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.assessment.residual_locations import Localisation, localise

SIGNALS = Signals.from_names(("u",), ("y",), "m")
TIME = np.arange(0, 60, 0.05)


def found(*errors: np.ndarray, block: float = 1.0) -> Localisation:
    random = np.random.default_rng(3)
    runs, points = [], []
    for k, error in enumerate(errors):
        modelled = np.sin(TIME)[:, None, None]
        measured = modelled + error[:, None, None] + random.normal(0, 0.01, modelled.shape)
        runs.append(Run(f"run{k}.csv", "fit", 100 + TIME, np.sin(TIME)[:, None], np.zeros((len(TIME), 3)), measured))
        points.append(modelled)
    return localise(runs, points, 0.01, SIGNALS, False, 0, block)


def test_a_moment_is_named_with_its_run_and_time() -> None:
    """A slow error of 0.1 everywhere, and ten times that for two seconds of the second run."""
    slow = 0.1 * np.sin(0.3 * TIME)
    contact = np.where((TIME >= 8) & (TIME < 10), 1.0, 0.0)
    answer = found(slow, slow + contact)
    (place,) = (p for p in answer.places if p.by == "moment")
    assert [p.name for p in found(slow, slow + contact, block=15.0).places if p.by == "moment"] == [place.name], "however long errors last"
    assert place.name == "108 s to 110 s of run1.csv"
    assert place.p <= 0.005
    squares = (slow**2).sum() + ((slow + contact) ** 2).sum()
    assert place.share == pytest.approx(((slow + contact)[(TIME >= 8) & (TIME < 10)] ** 2).sum() / squares, rel=0.02)
    assert f"{100 * place.share:.0f} % of it from 108 s to 110 s of run1.csv" in answer.sentence


def test_errors_of_the_whole_have_no_moment() -> None:
    random = np.random.default_rng(1)
    for error in (np.zeros(len(TIME)), 0.1 * np.sin(0.3 * TIME), 0.1 + 0.0 * TIME, np.cumsum(random.normal(0, 0.01, len(TIME)))):
        assert not [p for p in found(error, error).places if p.by == "moment"]


def test_what_comes_back_again_and_again_is_no_moment() -> None:
    """Pulses after each of ten steps hold as much in as little, but not at one time."""
    pulses = np.where(TIME % 6 < 0.5, 1.0, 0.0)
    assert not [p for p in found(pulses).places if p.by == "moment"]


def test_a_moment_is_of_one_run() -> None:
    """The end of one run and the beginning of the next are no stretch of time."""
    end, begin = np.where(TIME >= 59, 1.0, 0.0), np.where(TIME < 1, 1.0, 0.0)
    (place,) = (p for p in found(end, begin).places if p.by == "moment")
    assert place.name in {"159 s to 160 s of run0.csv", "100 s to 101 s of run1.csv"}


def test_a_run_of_less_than_a_second_has_no_moments() -> None:
    run = Run("short.csv", "fit", TIME[:5], np.zeros((5, 1)), np.zeros((5, 3)), np.ones((5, 1, 1)))
    assert localise([run], [np.zeros((5, 1, 1))], 0.01, SIGNALS, False, 0).places


def at_levels(measured: np.ndarray, modelled: np.ndarray, time: np.ndarray) -> set[str]:
    """Regimes of the level in which the model misses more."""
    points = measured[:, None, None] + np.random.default_rng(5).normal(0, 0.01, (len(time), 1, 1))
    run = Run("run.csv", "fit", time, time[:, None], np.zeros((len(time), 3)), points)
    answer = localise([run], [modelled[:, None, None]], 0.01, SIGNALS, False, 0)
    return {place.name for place in answer.places[: answer.telling]} & {"high y", "low y"}


def test_errors_at_high_levels_are_found() -> None:
    time = np.arange(0, 600, 0.5)
    truth = 1.2 * np.sin(0.05 * time)
    assert at_levels(np.minimum(truth, 0.8), 0.95 * truth, time) == {"high y"}


def test_levels_are_neither_those_measured_nor_those_modelled() -> None:
    """Two signals that have nothing in common differ most where either of them is far out, but that says nothing of the level."""
    time = np.arange(0, 3000, 0.5)
    random = np.random.default_rng(2)
    measured, modelled = (np.repeat(random.normal(0, 1, 3000), 2) for _ in range(2))
    assert not at_levels(measured, modelled, time)

"""Shifts between positions and inputs, against differences taken one lag after the other."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.discrepancy.preparation.clock import check_clock, find_time_shift
from tepm_opt.jobs.discrepancy import run_discrepancy

RATE = 50
NOISE = 3e-4  # m


def swing(seed: int, rows: int = 600) -> np.ndarray:
    """Points that sway irregularly by some cm, (rows, 4, 3) in m."""
    time, frequencies = np.arange(rows) / RATE, (0.2, 0.37, 0.5, 0.9, 1.3)
    parts = np.random.default_rng(seed).normal(0, 0.01, (5, 4, 3))
    waves = [part * np.sin(2 * np.pi * f * time + f)[:, None, None] for part, f in zip(parts, frequencies, strict=True)]
    return 0.3 + np.sum(waves, axis=0)


def run(points: np.ndarray) -> Run:
    rows = len(points)
    return Run("a.csv", "fit", np.arange(rows) / RATE, np.zeros((rows, 12)), np.zeros((rows, 3)), points)


def searched(measured: np.ndarray, modelled: np.ndarray, most: int) -> int:
    """The lag in rows with the least squared difference from a constant."""
    costs = []
    for lag in range(-most, most + 1):
        error = measured - modelled[np.clip(np.arange(len(measured)) - lag, 0, len(measured) - 1)]
        costs.append(np.nansum((error - np.nanmean(error, axis=0)) ** 2))
    return int(np.argmin(costs)) - most


@pytest.mark.parametrize("lag", [-140, -7, 61])
def test_finds_the_lag_with_the_least_difference(lag: int) -> None:
    modelled, random = swing(1), np.random.default_rng(2)
    measured = np.roll(modelled, lag, axis=0) + 0.02 + NOISE * random.normal(size=modelled.shape)
    measured[random.random(measured.shape) < 0.2] = np.nan
    measured[:, 1] = np.nan  # a point nobody sees
    found = find_time_shift([run(measured)], [modelled], NOISE).seconds
    seen = [0, 2, 3]
    assert round(found * RATE) == searched(measured[:, seen].reshape(600, -1), modelled[:, seen].reshape(600, -1), 250)
    assert abs(round(found * RATE) - lag) <= 1, "what a roll puts at the ends differs"


def doubted(measured: np.ndarray, modelled: np.ndarray) -> str:
    """What is said of a run, where no effect is known."""
    found = check_clock([run(measured)], [modelled], [modelled], NOISE)
    return found.sentence if found else ""


def test_noise_and_lags_of_a_machine_are_no_shift() -> None:
    modelled, random = swing(3), np.random.default_rng(4)
    for lag in (0, 10):
        assert not doubted(np.roll(modelled, lag, axis=0) + NOISE * random.normal(size=modelled.shape), modelled)


def held(filling: float, exhausting: float) -> tuple[np.ndarray, np.ndarray]:
    """Levels that are held, and how a machine follows whose lag differs between up and down, (rows, 4, 3) in m each."""
    modelled = np.repeat(np.random.default_rng(6).normal(0, 0.02, (15, 4, 3)), 200, axis=0)
    measured = modelled.copy()
    for k in range(1, len(measured)):
        away = modelled[k] - measured[k - 1]
        measured[k] = measured[k - 1] + away * (1 - np.exp(-1 / RATE / np.where(away > 0, filling, exhausting)))
    return modelled, measured + NOISE * np.random.default_rng(5).normal(size=measured.shape)


@pytest.mark.parametrize(("filling", "exhausting"), [(0.6, 0.6), (1.2, 1.2), (3.05, 2.6), (0.8, 1.4)])
def test_a_slow_machine_is_no_shift(filling: float, exhausting: float) -> None:
    modelled, measured = held(filling, exhausting)
    assert not doubted(measured, modelled)


def test_a_late_clock_is_a_shift_behind_a_lag_too() -> None:
    modelled, measured = held(0.1, 0.2)
    late = np.concatenate([measured[:1].repeat(100, axis=0), measured[:-100]])
    assert "trail the inputs by 2.08 s" in doubted(late, modelled)


def test_a_slow_machine_that_leads_is_a_shift() -> None:
    modelled = swing(7)
    assert "lead the inputs by 0.40 s, which would explain 97 % of what is left" in doubted(np.roll(modelled, -20, axis=0), modelled)


def test_effects_that_explain_more_are_no_clock() -> None:
    """Half of what a shift would leave, and nothing that a shift explains: the effects stand; twice as much: they do not."""
    modelled, random = swing(9), np.random.default_rng(10)
    runs = [run(np.roll(modelled, -20, axis=0) + 2e-3 * random.normal(size=modelled.shape))]
    noisy = 1e-3 * random.normal(size=modelled.shape)
    assert not check_clock(runs, [modelled], [runs[0].points + noisy], NOISE)
    found = check_clock(runs, [modelled], [runs[0].points + 4 * noisy], NOISE)
    assert found
    assert "lead" in found.sentence


def test_one_clock_among_good_ones() -> None:
    modelled = [swing(seed) for seed in (11, 12, 13)]
    runs = [replace(run(points), file=f"{k}.csv") for k, points in enumerate(modelled)]
    runs[1] = replace(runs[1], points=np.roll(runs[1].points, -20, axis=0))
    found = check_clock(runs, modelled, modelled, NOISE)
    assert found
    assert found.sentence.startswith(("1.csv: shifted clock: positions lead", "all runs"))


PLANT = """
from tepm_opt.discrepancy.adapters.equations import Equations

m = Equations("tank", laws=())
x, u = m.state("x"), m.input("u", size=1.0)
m.rate(x, (m.parameter("gain", 1.0, low=0.8, high=1.2) * u - x) / 0.2)
m.output("x", x, size=1.0)
plant = m.plant()
"""


@pytest.mark.slow
def test_a_plant_file_s_clock_is_warned_of(tmp_path: Path) -> None:
    """Levels are seen half a second before they are asked for."""
    file, data, random = tmp_path / "tank.py", tmp_path / "data", np.random.default_rng(8)
    file.write_text(PLANT, encoding="utf-8")
    data.mkdir()
    lines = ['name = "tank"', "[noise]", "x = 0.01"]
    time = np.arange(600) / RATE
    for number, role in enumerate(("fit", "fit", "validation")):
        asked, level = np.repeat(np.concatenate([[0.0], random.uniform(0, 1, 7)]), 75), np.zeros(600)
        for k in range(1, 600):
            level[k] = level[k - 1] + (asked[k - 1] - level[k - 1]) * (1 - np.exp(-1 / RATE / 0.2))
        seen = np.append(level[25:], np.repeat(level[-1:], 25)) + 0.01 * random.normal(size=600)
        rows = [f"{t:.2f},{u:.6f},{x:.6f}" for t, u, x in zip(time, asked, seen, strict=True)]
        (data / f"{number}.csv").write_text("\n".join(["time_s,u,x", *rows]) + "\n", encoding="utf-8")
        lines += ["[[runs]]", f'file = "{number}.csv"', f'role = "{role}"']
    (data / "dataset.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    verdict = run_discrepancy(data, tmp_path / "out", plant=file).verdict
    assert re.search(r"shifted clock: positions lead the inputs by 0\.(48|50) s", verdict.notes[0])
    assert verdict.status is VerdictStatus.UNEXPLAINED
    assert verdict.step.startswith("Next: put inputs and positions on one clock, then ask again: tepm discrepancy ")

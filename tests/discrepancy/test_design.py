"""What planned runs will tell, against plain least squares on a plant that is linear."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.discrepancy.experiments.information import information
from tepm_opt.discrepancy.experiments.settings import DEFAULT
from tests.discrepancy.straight import KNOWN, Straight, effect, planned

NOISE, RUNS = 0.3, planned("a.csv", "b.csv")
DRAG, LOAD = effect("drag", size=0.2), effect("load", x=0.1, y=0.1)
TWIN, BENT = effect("twin", size=0.5), effect("bent", smooth=False, size=0.4)
PLANT = Straight.of(DRAG, LOAD, TWIN, BENT, twin=("drag.size", 0.1))


def column(name: str) -> np.ndarray:
    return np.concatenate([PLANT.column(run, name).ravel() for run in RUNS]) / NOISE


def left(signature: np.ndarray, beside: tuple[str, ...] = ()) -> float:
    """Norm of what least squares with priors on the known parameters leaves."""
    rows = [
        np.append(column(name), [known == name for known in KNOWN] @ np.full(2, 1 / PLANT.prior) * np.eye(2)[k])
        for k, name in enumerate(KNOWN)
    ]
    by = np.stack([*rows, *(np.append(column(name), np.zeros(2)) for name in beside)], axis=1)
    whole = np.append(signature, np.zeros(2))
    return float(np.linalg.norm(whole - by @ np.linalg.lstsq(by, whole, rcond=None)[0]))


@pytest.mark.parametrize("name", ["drag", "bent"])
def test_what_is_found_is_two_standard_deviations_of_a_fit(name: str) -> None:
    told = information(PLANT, RUNS, NOISE, PLANT.candidates)
    move = next(move for move in told.moves if move.candidate.name == name)
    probe = move.probe[f"{name}.size"]
    found = told.separability(move, 0.15).found
    assert found == pytest.approx(DEFAULT.found_sigmas / left(probe * column(f"{name}.size")), rel=1e-9)
    assert move.values_at(found)[f"{name}.size"] == pytest.approx(found * probe)


def test_the_closest_rival_is_fitted_with_all_its_parameters() -> None:
    told = information(PLANT, RUNS, NOISE, PLANT.candidates)
    first = next(move for move in told.moves if move.candidate is DRAG)
    one = told.separability(first, 0.15)
    signature = 0.2 * column("drag.size")
    assert one.rival is TWIN
    assert one.apart == pytest.approx(DEFAULT.apart_sigmas / left(signature, ("twin.size",)), rel=1e-6)
    assert one.cosine == pytest.approx(np.sqrt(1 - (left(signature, ("twin.size",)) / left(signature)) ** 2), rel=1e-6)
    assert one.apart > 5 * one.found
    of_load = told.separability(next(move for move in told.moves if move.candidate is LOAD), 0.15)
    assert of_load.cosine < 0.6


def test_what_is_large_enough_takes_away_so_much_of_the_noise() -> None:
    told = information(PLANT, RUNS, NOISE, PLANT.candidates)
    one = told.separability(told.moves[0], 0.15)
    count = sum(run.points.size for run in RUNS)
    assert (told.residual_norm(told.moves[0]) * one.material) ** 2 / count == pytest.approx(0.15)
    assert told.count == count


def test_more_runs_tell_more() -> None:
    sizes = []
    for files in (("a.csv",), ("a.csv", "b.csv"), ("a.csv", "b.csv", "c.csv")):
        told = information(PLANT, planned(*files), NOISE, PLANT.candidates)
        sizes.append(told.separability(told.moves[0], 0.15).found)
    assert sizes[0] > sizes[1] > sizes[2]


def test_what_is_beyond_the_ranges_is_not_found() -> None:
    told = information(PLANT, RUNS, 1e4, PLANT.candidates)
    assert told.separability(told.moves[0], 0.15).found == np.inf

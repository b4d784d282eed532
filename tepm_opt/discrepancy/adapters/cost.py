"""Cost of a plant: time and memory of one simulation of the data, and how long a search of effects takes at least and at most."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.problem.plant import SearchablePlant
from tepm_opt.solvers.mechanics.plant import PredictionError

ROWS = 200  # samples that are simulated to measure the time
SEARCH = (50, 1000)  # simulations that a search is worth: 40 (silverbox, one effect) to 1,100 (cascaded tanks, nothing explains)


@dataclass(frozen=True)
class PlantCost:
    """Cost of a plant with some data.

    Attributes:
        simulation: time in s of one simulation of all runs with derivatives by the known parameters.
        memory: B of these derivatives.
    """

    simulation: float
    memory: int

    @property
    def sentence(self) -> str:
        """The cost in a line."""
        least, most = (_duration(count * self.simulation) for count in SEARCH)
        return (
            f"one simulation with derivatives takes {_duration(self.simulation)} and {self.memory / 1e6:.2g} MB; a search {least} to {most}"
        )


def measure_cost(plant: SearchablePlant, runs: Sequence[Run]) -> PlantCost | None:
    """Simulate the beginning of the shortest run twice and scale its time to all runs; None where it cannot be simulated.

    Args:
        plant: of a plant file.
        runs: to be fitted to.
    """
    first, plain = min(runs, key=lambda run: run.rows), plant.without_candidates
    part = replace(first, **{name: getattr(first, name)[:ROWS] for name in ("time", "inputs", "tip_force", "points")}, extra={})
    part = replace(part, state=np.array([*plain.states.values()])) if plain.states and part.start != "equilibrium" else part
    try:
        plain.predict(part, plant.known)  # builds the derivatives
        began = time.monotonic()
        plain.predict(part, plant.known)
    except PredictionError:
        return None
    seconds = time.monotonic() - began
    rows, values = sum(run.rows for run in runs), sum(run.points.size for run in runs)
    return PlantCost(seconds * rows / max(part.rows, 1), 8 * len(plant.known) * values)


def _duration(seconds: float) -> str:
    """A time as people say it."""
    return f"{seconds:.2g} s" if seconds < 90 else f"{seconds / 60:.2g} min" if seconds < 5400 else f"{seconds / 3600:.2g} h"

"""What a plant costs: told before a search begins."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tepm_opt.discrepancy.adapters.cost import PlantCost, measure_cost
from tepm_opt.solvers.mechanics.plant import PredictionError
from tests.discrepancy.test_quick_plants import runs, tank


def test_one_simulation_is_scaled_to_all_runs() -> None:
    """Twice the runs take twice the memory, and at least as long as a part of them does."""
    plant = tank().plant()
    one, two = measure_cost(plant, runs(2, 2.0, rows=400)), measure_cost(plant, runs(4, 2.0, rows=400))
    assert one is not None
    assert two is not None
    assert (one.memory, two.memory) == (8 * 800, 8 * 1600)
    assert 0 < two.simulation < 1.0


def test_the_sentence_tells_a_range_in_units_that_people_use() -> None:
    assert PlantCost(0.4, 2_000_000).sentence == "one simulation with derivatives takes 0.4 s and 2 MB; a search 20 s to 6.7 min"
    assert PlantCost(12.6, 960_000).sentence.endswith("a search 10 min to 3.5 h")


def test_a_run_that_does_not_begin_at_rest_is_simulated_too() -> None:
    """From the plant's guess of its state: the time is the same."""
    (run,) = runs(1, 2.0)
    assert measure_cost(tank().plant(), [replace(run, start="free", inputs=np.full_like(run.inputs, 1.0))]) is not None


def test_a_plant_that_cannot_do_the_runs_has_no_cost() -> None:
    class Failing:
        """A plant without any motion."""

        known: tuple[str, ...] = ()
        states: dict[str, float] = {}  # noqa: RUF012  a stand-in

        @property
        def without_candidates(self) -> Any:
            return self

        def predict(self, *args: Any) -> Any:
            raise PredictionError("no motion")

    assert measure_cost(Failing(), runs(1, 2.0)) is None  # type: ignore[arg-type]

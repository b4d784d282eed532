"""A user's machine: a Python file that ends with `plant = …`."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any, cast

from tepm_opt.data.python_files import run_file
from tepm_opt.discrepancy.problem.plant import SearchablePlant
from tepm_opt.errors import InputError

NEEDED = ("signals", "known", "candidates", "values", "states", "predict", "with_values", "free", "corrected_model")


def load_plant(path: str | Path) -> SearchablePlant:
    """The plant of a Python file, which is run: `plant`, or what a function of this name gives.

    Raises:
        InputError: no such file, it fails, or it has no plant.
    """
    path = Path(path)
    plant = run_file(path, "plant_file", "a file that ends with plant = …", _plant)
    if plant is None:
        raise InputError(f"{path}: has no plant; valid: a file that ends with plant = …")
    if lacking := [name for name in NEEDED if not hasattr(plant, name)]:
        raise InputError(
            f"{path}: plant is a {type(plant).__name__} without {lacking[0]!r}; valid: Equations(…).plant() or Simulator(…).plant(…)"
        )
    return cast(SearchablePlant, plant)


def _plant(module: ModuleType) -> Any:
    plant = getattr(module, "plant", None)
    return plant() if callable(plant) else plant

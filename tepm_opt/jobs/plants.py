"""A user's machine: a Python file that ends with `plant = …`."""

from __future__ import annotations

import importlib.util
import sys
import traceback
from pathlib import Path
from typing import Any, cast

from tepm_opt.discrepancy.plant import SearchablePlant
from tepm_opt.errors import InputError

NEEDED = ("signals", "known", "candidates", "values", "states", "predict", "with_values", "free", "corrected")


def load_plant(path: str | Path) -> SearchablePlant:
    """The plant of a Python file, which is run: `plant`, or what a function of this name gives.

    Raises:
        InputError: no such file, it fails, or it has no plant.
    """
    path = Path(path)
    spec = importlib.util.spec_from_file_location("plant_file", path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise InputError(f"{path}: no such Python file; valid: a file that ends with plant = …")
    module = importlib.util.module_from_spec(spec)
    folder, before = path.resolve().parent, set(sys.modules)
    sys.path.insert(0, str(folder))
    try:
        spec.loader.exec_module(module)
        plant: Any = getattr(module, "plant", None)
        plant = plant() if callable(plant) else plant
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (Exception, SystemExit) as error:
        raise InputError(f"{path}: {_failure(error, path)}") from error
    finally:
        sys.path.remove(str(folder))
        for name in set(sys.modules) - before:  # what stands beside it is read anew the next time
            if Path(getattr(sys.modules[name], "__file__", None) or "").parent == folder:
                del sys.modules[name]
    if plant is None:
        raise InputError(f"{path}: has no plant; valid: a file that ends with plant = …")
    if lacking := [name for name in NEEDED if not hasattr(plant, name)]:
        raise InputError(
            f"{path}: plant is a {type(plant).__name__} without {lacking[0]!r}; valid: Equations(…).plant() or Simulator(…).plant(…)"
        )
    return cast(SearchablePlant, plant)


def _failure(error: BaseException, path: Path) -> str:
    """Where in the file and how it failed, in a line."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    line, text = next(reversed(lines), None), " ".join(str(error).split())
    if isinstance(error, SyntaxError) and error.filename == str(path):
        line, text = error.lineno, error.msg
    return f"{f'line {line}: ' if line else ''}{type(error).__name__}: {text}"

"""Reading what the commands write, without the package's own reader, and the columns the file formats name."""

from __future__ import annotations

import csv
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np

TABLES = {"inputs.csv", "inputs_rounded.csv", "shape.csv", "lengths.csv"}
IK_FILES = TABLES | {"summary.json", "ik.png"}


def input_columns(modules: int = 2, actuators: int = 3) -> list[str]:
    """`time_s`, all pressures, all tensions, module-major."""
    names = [f"{h}{j}" for h in range(1, modules + 1) for j in range(1, actuators + 1)]
    return ["time_s", *(f"pressure_{name}_Pa" for name in names), *(f"tension_{name}_N" for name in names)]


def shape_columns(points: int = 4) -> list[str]:
    """`time_s` and the reference points in G."""
    return ["time_s", *(f"s{k}_{axis}_m" for k, axis in itertools.product(range(1, points + 1), "xyz"))]


def length_columns(modules: int = 2, actuators: int = 3) -> list[str]:
    """`time_s` and the lengths of all actuators."""
    return ["time_s", *(f"length_{h}{j}_m" for h in range(1, modules + 1) for j in range(1, actuators + 1))]


def gain_columns(inputs: int = 12) -> list[str]:
    """G row by row."""
    return [f"g_{row}_{number}" for row in (1, 2, 3) for number in range(1, inputs + 1)]


def table(path: Path) -> tuple[list[str], np.ndarray]:
    """Header and values of a CSV file, an empty field being NaN."""
    with path.open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    return header, np.array([[float(field or "nan") for field in row] for row in rows])


def values(path: Path) -> np.ndarray:
    """Values of a CSV file without its header."""
    return table(path)[1]


def tips(folder: Path) -> np.ndarray:
    """Tip in G of every row of a folder's shape.csv, (rows, 3) in m."""
    return values(folder / "shape.csv")[:, -3:]


def summary(folder: Path, job: str) -> dict[str, Any]:
    """A job's part of a folder's summary.json."""
    return json.loads((folder / "summary.json").read_text(encoding="utf-8"))[job]


def names_in(folder: Path) -> set[str]:
    """Names of everything in a folder, hidden files too."""
    return {path.name for path in folder.iterdir()}


def write_rows(path: Path, header: list[str], rows: np.ndarray) -> Path:
    """Write a CSV file of a user's."""
    path.write_text("\n".join([",".join(header), *(",".join(repr(float(v)) for v in row) for row in np.atleast_2d(rows))]) + "\n")
    return path


def circle(points: int, radius: float = 0.150, height: float = 0.350) -> np.ndarray:
    """Eq. (7) in m."""
    angle = 2 * np.pi * np.arange(points) / points
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(points, height)], axis=1)

"""A motion of kang2017's size in closed form: what any table of it holds at any time, and by how much a grid of its samples may be off."""

from __future__ import annotations

from functools import cache

import numpy as np

from tests.data.made import ACTUATORS, BASE, NAMES, POINTS

LENGTH = 6.0  # s; at rest for the first second and the last
COMMANDS = tuple(NAMES.inputs)
PLACES = tuple(NAMES.coordinates)


def window(time: np.ndarray) -> np.ndarray:
    """sin⁶ from 1 to 5 s, else 0: five derivatives go on through both ends."""
    return np.where((time > 1) & (time < 5), np.sin(np.pi * (time - 1) / 4) ** 6, 0.0)


def signals(time: np.ndarray, run: int = 0) -> dict[str, np.ndarray]:
    """Columns of SPEC section 4 by name at any times in s, in SI; other runs go other ways."""
    time = np.asarray(time, dtype=float)
    swing = {name: window(time) * np.sin(2 * np.pi * (0.9 * time + 0.1 * k + 0.23 * run)) for k, name in enumerate(ACTUATORS)}
    found = {f"pressure_{name}_Pa": 1.5e5 + 5e4 * each for name, each in swing.items()}
    found |= {f"tension_{name}_N": 2.0 + 1.5 * each for name, each in swing.items()}
    sway = window(time) * np.sin(2 * np.pi * (1.1 * time + 0.31 * run))
    turn = window(time) * np.cos(2 * np.pi * (0.8 * time + 0.17 * run))
    for k, name in enumerate(POINTS):
        height = 0.1 * (k + 1)
        place = (0.4 * height**2 * sway, 0.3 * height**2 * turn, height * (1 + 0.02 * sway))
        for axis, value, base in zip("xyz", place, BASE, strict=True):
            found[f"{name}_{axis}_m"] = value + base
    return found


@cache
def steepest(order: int, run: int) -> dict[str, float]:
    """Largest value of a derivative of each column, by differences on a fine grid."""
    fine = np.arange(0, LENGTH, 1e-3)
    found = {}
    for name, values in signals(fine, run).items():
        for _ in range(order):
            values = np.gradient(values, 1e-3)
        found[name] = float(np.abs(values).max())
    return found


def line_error(step: float, run: int = 0) -> dict[str, float]:
    """Of straight lines between samples: h²/8 · max |y''|."""
    return {name: step**2 / 8 * value for name, value in steepest(2, run).items()}


def hold_error(step: float, run: int = 0) -> dict[str, float]:
    """Of the last value: h · max |y'|."""
    return {name: step * value for name, value in steepest(1, run).items()}


def spline_error(step: float, run: int = 0) -> dict[str, float]:
    """Of a cubic spline: 5/384 · h⁴ · max |y''''| (Hall and Meyer 1976)."""
    return {name: 5 / 384 * step**4 * value for name, value in steepest(4, run).items()}

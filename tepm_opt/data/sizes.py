"""Values that are in another unit than they should be: one judgement, in the same words, for data sets, set points and options."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tepm_opt.errors import InputError

FARTHEST = 50.0  # m; beyond it a coordinate is taken for millimetres
METRES = f"metres within {FARTHEST:g} m, not millimetres"
SMALL = 1.2e-3  # of the limit; below it the largest value of a motion is no motion in the right unit: 0.5 MPa in kPa is 1e-3
PLAUSIBLE = 0.02, 1.01  # of the limit: what the largest value may be in the unit that was meant
LARGE = 8.0  # times what the robot's size lets expect: no posture puts a point there
LENGTHS = {1e3: "mm", 1e2: "cm", 39.37: "inches"}
"""Units of length that a file may be in by mistake, by how many of them a metre has."""


@dataclass(frozen=True)
class Quantity:
    """Pressures or tensions.

    Attributes:
        name: at the beginning of their columns.
        unit: that they should have.
        others: units in which people give them by mistake, and what one of each is in the right unit.
    """

    name: str
    unit: str
    others: Mapping[str, float]

    def suspect_unit(self, largest: float, limit: float) -> str:
        """The unit in which a largest value would be plausible for a limit: the one that comes nearest to it from below; or nothing."""
        parts = {name: largest * factor / limit for name, factor in self.others.items()}
        fits = {name: part for name, part in parts.items() if PLAUSIBLE[0] < part <= PLAUSIBLE[1]}
        return max(fits, key=fits.__getitem__) if fits else ""

    def valid(self, largest: float, limit: float) -> str:
        """Valid range, with the unit that was perhaps meant: "0 … 500000 Pa: in kPa?"."""
        unit = self.suspect_unit(largest, limit)
        return f"0 … {limit:g} {self.unit}" + (f": in {unit}?" if unit else "")

    def judge(self, largest: float, limit: float) -> str:
        """Sentence about values of which the largest is far too small or beyond the limit; empty where nothing is."""
        if not np.isfinite(limit) or not (0 < largest <= SMALL * limit or largest > limit * (1 + 1e-6)):
            return ""
        return f"{self.name}s reach {largest:g}; valid: {self.valid(largest, limit)}"


PRESSURE = Quantity("pressure", "Pa", {"kPa": 1e3, "bar": 1e5, "MPa": 1e6, "psi": 6894.757})
TENSION = Quantity("tension", "N", {"mN": 1e-3, "g": 9.80665e-3, "kg": 9.80665, "kN": 1e3})


def judge_inputs(inputs: np.ndarray, limits: np.ndarray) -> str:
    """Sentence about inputs that are plausible in another unit only; empty where nothing is.

    Values that are too small in every unit stay: rounding leaves such.

    Args:
        inputs: pressures in Pa, then tensions in N, (…, inputs).
        limits: upper limits of them, (inputs,).
    """
    half = inputs.shape[-1] // 2
    for quantity, part in ((PRESSURE, slice(0, half)), (TENSION, slice(half, None))):
        limit, values = float(np.max(limits[part], initial=0.0)), inputs[..., part]
        largest = float(np.nanmax(values, initial=0.0)) if np.isfinite(values).any() else 0.0
        if 0 < largest <= SMALL * limit and quantity.suspect_unit(largest, limit):
            return quantity.judge(largest, limit)
    return ""


def judge_force(force: float, most: float) -> str:
    """Sentence about a force on the tip, in N, that is more than all tendons together can pull; empty where nothing is."""
    if not force > most:
        return ""
    return f"a tip force of {force:g} N is more than all tendons together can pull ({most:g} N): in g or mN?"


def refuse_millimetres(place: Sequence[float] | np.ndarray, where: str) -> None:
    """Refuse a place (3,) or a length that no room holds if it is in m.

    Raises:
        InputError: in the words that files in millimetres get.
    """
    for name, value in zip(("x", "y", "z"), np.ravel(place), strict=False):
        if abs(value) > FARTHEST:
            raise InputError(f"{where}: {name} = {value:g}; valid: {METRES}")


def tell_places(ratio: float, unit: str) -> str:
    """The words for positions that are so many times as far as the robot reaches, and would not be in another unit."""
    return f"positions are {ratio:.3g} times what the robot's size allows: in {unit}, not m?"


def judge_places(places: np.ndarray, base: Sequence[float], height: float) -> str:
    """Sentence about places of the tip that are far beyond a robot's size; empty where nothing is.

    Args:
        places: (places, 3) in m in G; NaN where there is none.
        base: of the robot in G, (3,) in m.
        height: of the tip above the base at rest in m.
    """
    apart = np.linalg.norm(np.reshape(places, (-1, 3)) - np.asarray(base), axis=1)
    apart = apart[np.isfinite(apart)]
    ratio = float(np.median(apart)) / height if len(apart) else 0.0
    if ratio <= LARGE:
        return ""
    unit = min(LENGTHS, key=lambda factor: abs(np.log(ratio / factor)))
    return tell_places(ratio, LENGTHS[unit])

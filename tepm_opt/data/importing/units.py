"""Units that tables are written in, and what one of each is in the data set's."""

from __future__ import annotations

import difflib
from collections.abc import Mapping

from scipy.constants import atm, bar, degree, hour, inch, kgf, lbf, minute, psi, torr

from tepm_opt.errors import InputError

UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": minute, "h": hour},
    "pressure": {
        "Pa": 1.0, "hPa": 1e2, "kPa": 1e3, "MPa": 1e6, "mbar": 1e-3 * bar, "bar": bar, "psi": psi, "atm": atm, "mmHg": torr,
        "kgf/cm2": 1e4 * kgf,
    },
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "gf": 1e-3 * kgf, "kgf": kgf, "lbf": lbf},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "in": inch, "ft": 12 * inch},
    "angle": {"rad": 1.0, "deg": degree, "°": degree, "mrad": 1e-3},
}  # fmt: skip
"""By dimension: what one of a unit is in SI."""
USUAL: Mapping[str, tuple[str, ...]] = {
    "pressure": ("Pa", "kPa", "MPa", "bar", "psi"),
    "force": ("N", "mN", "gf", "kgf"),
    "length": ("m", "cm", "mm", "in"),
}
"""Units that values without one are taken to be in."""


def likely(largest: float, limit: float, dimension: str) -> str | None:
    """The usual unit in which a value comes nearest to its limit from below.

    Args:
        largest: of the values, as they are written.
        limit: of the robot in SI.
        dimension: a key of `USUAL`.

    Returns:
        The unit; None where the value is more than the limit, or below 2 % of it, in all of them.
    """
    parts = {unit: UNITS[dimension][unit] * largest / limit for unit in USUAL[dimension]}
    fitting = {unit: part for unit, part in parts.items() if 0.02 < part <= 1 + 1e-6}
    return max(fitting, key=fitting.__getitem__) if fitting else None


def factor(unit: str, dimension: str | None) -> float:
    """Size of a unit in SI.

    Args:
        unit: "kPa"; empty means SI.
        dimension: a key of `UNITS`; None where any will do, as for columns of a machine of one's own.

    Raises:
        InputError: no such unit, or one of another dimension; lists the valid ones.
    """
    known = {name: value for units in UNITS.values() for name, value in units.items()} if dimension is None else UNITS[dimension]
    if not unit:
        return 1.0
    if unit not in known:
        raise InputError(f"unit {unit!r}: valid: {', '.join(known)}")
    return known[unit]


def nearest(unit: str, dimension: str | None) -> str:
    """The valid unit that is written most like this one; the first of its dimension where none is."""
    known = list(UNITS[dimension]) if dimension else [name for units in UNITS.values() for name in units]
    alike = {name.lower(): name for name in reversed(known)}
    found = difflib.get_close_matches(unit.lower().strip(), alike, n=1, cutoff=0.3)
    return alike[found[0]] if found else known[0]

"""Terms that formulas are made of: dimensionless functions of a variable, as numbers and as the text of a program."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

END = 0.03  # of the visited range
ROUNDED = 0.02  # of the reference: half-width of a ramp's rounded corner

FORMS: Mapping[str, tuple[str, Callable[..., np.ndarray]]] = {
    "constant": ("1.0", lambda z, r, s: np.ones_like(z)),
    "linear": ("({z} / {r})", lambda z, r, s: z / r),
    "quadratic": ("({z} / {r}) ** 2", lambda z, r, s: (z / r) ** 2),
    "cubic": ("({z} / {r}) ** 3", lambda z, r, s: (z / r) ** 3),
    "signed_square": ("({z} / {r}) * ca.sqrt(({z} / {r}) ** 2 + 1e-6)", lambda z, r, s: z / r * np.sqrt((z / r) ** 2 + 1e-6)),
    "ramp": ("ramp(({z} - {s}) / {r})", lambda z, r, s: ramp((z - s) / r)),
    "saturation": ("ca.tanh({z} / {s})", lambda z, r, s: np.tanh(z / s)),
    "decay": ("ca.exp(-{z} / {s})", lambda z, r, s: np.exp(-z / s)),
    "hyperbola": ("1 / (1 + {z} / {s})", lambda z, r, s: 1 / (1 + z / s)),
    "sine": ("ca.sin({z} / {s})", lambda z, r, s: np.sin(z / s)),
    "cosine": ("ca.cos({z} / {s})", lambda z, r, s: np.cos(z / s)),
}
"""By name: the text with {z} the variable, {r} its reference value and {s} the scale, and the same for arrays."""
INTEGRALS: Mapping[str, str] = {
    "constant": "{z}",
    "linear": "{z} ** 2 / (2 * {r})",
    "quadratic": "{z} ** 3 / (3 * {r} ** 2)",
    "cubic": "{z} ** 4 / (4 * {r} ** 3)",
    "signed_square": "{r} * (({z} / {r}) ** 2 + 1e-6) ** 1.5 / 3",
    "ramp": "{r} * ramp_integral(({z} - {s}) / {r}) / 2",
    "saturation": "{s} * ca.log(ca.cosh({z} / {s}))",
    "decay": "-{s} * ca.exp(-{z} / {s})",
    "hyperbola": "{s} * ca.log(1 + {z} / {s})",
    "sine": "-{s} * ca.cos({z} / {s})",
    "cosine": "{s} * ca.sin({z} / {s})",
}
"""Texts of the functions' integrals over the variable."""
SCALED = ("ramp", "saturation", "decay", "hyperbola", "sine", "cosine")


def ramp(x: np.ndarray) -> np.ndarray:
    """max(x, 0) with a rounded corner: no law of a machine bends at a point."""
    return (x + np.sqrt(x**2 + ROUNDED**2)) / 2


@dataclass(frozen=True)
class Term:
    """A dimensionless function of a variable; its coefficient has the law's unit.

    Attributes:
        kind: a name in `FORMS`.
        scale: in the variable's unit, where the form has one.
    """

    kind: str
    scale: float = 0.0

    def __call__(self, values: np.ndarray, reference: float) -> np.ndarray:
        """The function's values."""
        return FORMS[self.kind][1](values, reference, self.scale)

    def text(self, variable: str, reference: float, scale: str) -> str:
        """The function as a program writes it, with the names of variable and scale."""
        return FORMS[self.kind][0].format(z=variable, r=f"{reference:g}", s=scale)

    def integral(self, variable: str, reference: float, scale: str) -> str:
        """The function's integral over the variable, as a program writes it."""
        return INTEGRALS[self.kind].format(z=variable, r=f"{reference:g}", s=scale)


@dataclass(frozen=True)
class Terms:
    """Terms as a shape of laws.

    Attributes:
        terms: each has a coefficient.
        reference: of the variable, in its unit.
        origin: of the variable, in its unit: what it is counted from.
    """

    terms: tuple[Term, ...]
    reference: float
    origin: float = 0.0

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return len(self.terms)

    @property
    def penalty(self) -> np.ndarray:
        """No preference but for small ones."""
        return np.eye(self.size)

    def columns(self, values: np.ndarray, time: np.ndarray) -> np.ndarray:
        """What each term contributes, (samples, …, terms)."""
        return np.stack([term(values - self.origin, self.reference) for term in self.terms], axis=-1)


def rounded(value: float) -> float:
    """One significant digit, for a reference that people read."""
    return float(f"{value:.0e}") if value else 1.0


def library(values: np.ndarray, origin: float, periodic: bool) -> Terms:
    """Terms over the visited values of a variable; scales stand where the values are, or through their range.

    Args:
        values: visited.
        origin: what the variable is counted from.
        periodic: whether it is a time, in which laws may come back.
    """
    z = values.ravel() - origin
    reference = rounded(float(np.abs(z).max()))
    low, high = float(z.min()), float(z.max())
    found = [Term(kind) for kind in ("constant", "linear", "quadratic", "cubic")]
    if low < 0:
        found.append(Term("signed_square"))
        found += [Term("saturation", part * max(-low, high)) for part in (0.01, 0.05, 0.2)]
    else:
        found += [Term(kind, part * high) for kind in ("decay", "hyperbola", "saturation") for part in (0.05, 0.15, 0.4, 1.0)]
    parts = np.linspace(0.05, 0.95, 10)
    bends = np.sort(np.concatenate([np.quantile(z, parts), low + parts * (high - low)]))
    bends = bends[(bends > low + END * (high - low)) & (bends < high - END * (high - low))]  # nearer to an end a ramp is a line
    found += [Term("ramp", float(bend)) for bend in _apart(bends, 0.02 * (high - low))]
    if periodic:
        found += [Term(kind, (high - low) / (2 * np.pi * turns)) for turns in (0.5, 1.0, 2.0, 4.0, 8.0) for kind in ("sine", "cosine")]
    return Terms(tuple(found), reference, origin)


def _apart(values: Sequence[float] | np.ndarray, distance: float) -> list[float]:
    kept: list[float] = []
    for value in values:
        if not kept or value - kept[-1] >= distance:
            kept.append(float(value))
    return kept

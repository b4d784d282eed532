"""Terms of formulas: dimensionless functions of a variable, as numbers and as the text of a program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

FORMS: Mapping[str, tuple[str, str]] = {
    "constant": ("1.0", "{z}"),
    "linear": ("({z} / {r})", "{z} ** 2 / (2 * {r})"),
    "quadratic": ("({z} / {r}) ** 2", "{z} ** 3 / (3 * {r} ** 2)"),
    "cubic": ("({z} / {r}) ** 3", "{z} ** 4 / (4 * {r} ** 3)"),
    "signed_square": ("({z} / {r}) * ca.sqrt(({z} / {r}) ** 2 + 1e-6)", "{r} * (({z} / {r}) ** 2 + 1e-6) ** 1.5 / 3"),
    "ramp": ("ramp(({z} - {s}) / {r})", "{r} * ramp_integral(({z} - {s}) / {r}) / 2"),
    "saturation": ("ca.tanh({z} / {s})", "{s} * ca.log(ca.cosh({z} / {s}))"),
    "decay": ("ca.exp(-{z} / {s})", "-{s} * ca.exp(-{z} / {s})"),
    "hyperbola": ("1 / (1 + {z} / {s})", "{s} * ca.log(1 + {z} / {s})"),
    "sine": ("ca.sin({z} / {s})", "-{s} * ca.cos({z} / {s})"),
    "cosine": ("ca.cos({z} / {s})", "{s} * ca.sin({z} / {s})"),
}
"""By name: texts of the function and its integral, with {z} the variable, {r} its reference value and {s} the scale."""


def ramp(x: np.ndarray) -> np.ndarray:
    """max(x, 0) with a rounded corner, as laws of machines have no sharp one; see `templates`."""
    return (x + np.sqrt(x**2 + 0.02**2)) / 2


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
        text = FORMS[self.kind][0].format(z="z", r="r", s="s")
        found = eval(text, {"ca": np, "ramp": ramp}, {"z": values, "r": reference, "s": self.scale})  # a text of the table above
        return np.broadcast_to(found, np.shape(values))

    @property
    def has_scale(self) -> bool:
        """Whether the function depends on `scale`."""
        return "{s}" in FORMS[self.kind][0]

    def text(self, variable: str, reference: float, scale: str) -> str:
        """The function as a program writes it, with the names of variable and scale."""
        return FORMS[self.kind][0].format(z=variable, r=f"{reference:g}", s=scale)

    def integral(self, variable: str, reference: float, scale: str) -> str:
        """The function's integral over the variable, as a program writes it."""
        return FORMS[self.kind][1].format(z=variable, r=f"{reference:g}", s=scale)


@dataclass(frozen=True)
class Terms:
    """Terms as a shape of laws.

    Attributes:
        terms: each has a coefficient.
        reference: of the variable, in its unit.
        origin: of the variable, in its unit.
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
        """Contribution of each term, (samples, …, terms)."""
        return np.stack([term(values - self.origin, self.reference) for term in self.terms], axis=-1)


def terms_over(values: np.ndarray, origin: float, periodic: bool) -> Terms:
    """Terms over the visited values of a variable, with scales at quantiles of the values or evenly over their range.

    Args:
        values: visited.
        origin: of the variable.
        periodic: whether it is a time, of which laws may be periodic functions.
    """
    z = values.ravel() - origin
    low, high, most = float(z.min()), float(z.max()), float(np.abs(z).max())
    reference = float(f"{most:.0e}") if most else 1.0  # one digit, for people who read it
    found = [Term(kind) for kind in ("constant", "linear", "quadratic", "cubic")]
    if low < 0:
        found.append(Term("signed_square"))
        found += [Term("saturation", part * max(-low, high)) for part in (0.01, 0.05, 0.2)]
    else:
        found += [Term(kind, part * high) for kind in ("decay", "hyperbola", "saturation") for part in (0.05, 0.15, 0.4, 1.0)]
    parts = np.linspace(0.05, 0.95, 10)
    bends = np.sort(np.concatenate([np.quantile(z, parts), low + parts * (high - low)]))
    edge, kept = 0.03 * (high - low), -np.inf  # nearer to an end of the range a ramp is a line
    for bend in bends[(bends > low + edge) & (bends < high - edge)].tolist():
        if bend - kept >= 0.02 * (high - low):
            found.append(Term("ramp", bend))
            kept = bend
    if periodic:
        found += [Term(kind, (high - low) / (2 * np.pi * turns)) for turns in (0.5, 1.0, 2.0, 4.0, 8.0) for kind in ("sine", "cosine")]
    return Terms(tuple(found), reference, origin)

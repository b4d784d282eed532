"""Figure of a law that was found: the formula with its band over what was visited, and the smooth law of the first look."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from tepm_opt.discrepancy.symbolic.invent import Invention
from tepm_opt.discrepancy.symbolic.page import curves
from tepm_opt.discrepancy.symbolic.places import VARIABLE_UNITS
from tepm_opt.discrepancy.symbolic.writing import curve
from tepm_opt.plots.figure import STYLE
from tepm_opt.plots.palette import CORRECTED, MEASURED, RECALIBRATED

SIGMAS = 2.0


def law_figure(law: Invention) -> Figure | None:
    """The law over its variable; None where it is of several variables or remembers."""
    place, shapes = law.formula.place, curves(law)
    if shapes is None:
        return None
    terms, first = shapes
    values = np.linspace(first.knots[0], first.knots[-1], 300)
    formula = law.fitted_formula
    found = curve(formula, values)
    parts = terms.columns(values, values)[..., list(formula.chosen)]
    relative = np.array([law.relative_std(name) for name in law.written.terms])
    band = SIGMAS * np.sqrt(((parts * formula.coefficients * relative) ** 2).sum(axis=1))
    smooth = first.columns(values, values)
    spread = SIGMAS * np.sqrt(np.einsum("ki,ij,kj->k", smooth, law.scored.covariance, smooth))
    figure = Figure(figsize=(6.4, 4.0), **STYLE)
    axes = figure.add_subplot()
    look = smooth @ law.scored.coefficients
    axes.fill_between(values, look - spread, look + spread, color=MEASURED.color, alpha=0.25, lw=0)
    axes.plot(values, look, color=MEASURED.color, ls="--", label="smooth law, first order")
    axes.fill_between(values, found - band, found + band, color=CORRECTED.color, alpha=0.25, lw=0)
    axes.plot(values, found, **CORRECTED.lined, label="formula, fitted")
    for run in law.beyond:
        axes.axvspan(max(run.low, values[0]) if run.high > values[-1] else run.low, run.high, color=RECALIBRATED.color, alpha=0.08, lw=0)
    axes.set_xlabel(f"{place.variable} / {VARIABLE_UNITS.get(place.variable, '')}")
    axes.set_ylabel(f"force / {place.unit}")
    axes.set_title(f"{place.label}: closes {law.closes:.0%} of what is left")
    axes.legend(frameon=False)
    return figure

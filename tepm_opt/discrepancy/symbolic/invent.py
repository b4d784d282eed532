"""A law where no known effect fits: the place that predicts most, its shortest formula, written as an effect and fitted as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tepm_opt.data.files import output_folder, write_atomically
from tepm_opt.data.metrics import error_over_time
from tepm_opt.data.run import Run
from tepm_opt.discrepancy.adapters.network import acting_effect
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.cross_validation import leave_out
from tepm_opt.discrepancy.symbolic.formula import Formula, compress, named, with_terms
from tepm_opt.discrepancy.symbolic.places import Course, places
from tepm_opt.discrepancy.symbolic.responses import courses
from tepm_opt.discrepancy.symbolic.score import Scored, scored
from tepm_opt.discrepancy.symbolic.writing import Written, refitted, writable, write
from tepm_opt.models.compile import compile_model
from tepm_opt.models.effect import ActiveEffect
from tepm_opt.models.effect_files import load_effects, unload_effect
from tepm_opt.models.layout import Layout
from tepm_opt.models.model import Model
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.identify import ParameterEstimate, identify
from tepm_opt.solvers.network_plant import NetworkPlant
from tepm_opt.solvers.plant import PredictionError

LEAST = 0.25  # part of the structure left that a law has to predict in left-out data
PROMISING = 0.05  # the same of a smooth law to first order, which is coarser than a formula
NEAR = 0.15  # of the structure left, by which another place may be worse to first order and still be tried
NOISE = 0.05  # excess of the squares over the noise that counts as noise
TRIED = 3  # places whose formulas are sought
FITTED = 2  # formulas that are fitted
BEYOND = 0.02  # of the visited range, by which a run may leave it unnoticed
STEPS = 12


@dataclass(frozen=True, eq=False)
class Beyond:
    """A run in which the law is asked for what it was never shown: a variable of it there, and what was visited, in its unit."""

    file: str
    variable: str
    low: float
    high: float
    visited: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Invention:
    """A law found.

    Attributes:
        scored: its place with the smooth law there, to first order.
        formula: the shortest one that predicts as well, to first order.
        written: its effect file.
        file: where that is.
        estimate: the model with the law, fitted.
        model: the same to go on with.
        closes: part of the structure left that it closes in left-out data.
        errors: root mean square of Eq. (5) in m on the runs judged: without the law and with it.
        beyond: runs in which it extrapolates.
        places: all places, the one that predicts most first.
    """

    scored: Scored
    formula: Formula
    written: Written
    file: Path
    estimate: ParameterEstimate
    model: Model
    closes: float
    errors: tuple[float, float]
    beyond: tuple[Beyond, ...]
    places: tuple[Scored, ...]

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Invention({self.written.name}, closes {self.closes:.3f})"

    def relative_std(self, parameter: str) -> float:
        """Standard deviation of a parameter of the effect over its value."""
        at = [f.name for f in self.estimate.problem.free].index(f"{self.written.name}.{parameter}")
        return float(self.estimate.std[at] / max(abs(self.estimate.values[at]), 1e-300))

    @property
    def fitted_formula(self) -> Formula:
        """The formula with the coefficients and scales that the fit found."""
        return refitted(self.formula, self.written, self.estimate.plant.values)


def invent(
    estimate: ParameterEstimate, known: Model, folder: Path, source: str, judged: Sequence[Run] = (), progress: Progress = silent
) -> Invention | None:
    """A law for what an estimate leaves; None where nothing is left that a law at any place would predict. Its effect is loaded.

    Args:
        estimate: the best that known effects do, of a network.
        known: its model with those effects and their values; what is free in the estimate has to be in it.
        folder: for the effect file.
        source: name of the data, for people.
        judged: runs that were not fitted to; those fitted to where there are none.
        progress: told of every piece of work.

    Raises:
        PredictionError: the model cannot do a run.
    """
    plant = estimate.plant
    if not isinstance(plant, NetworkPlant) or estimate.cost <= (1 + NOISE) * estimate.count:
        return None
    layout = plant.model.layout
    progress("looking where a law may act", 0, 0)
    made = courses(plant, estimate.problem.runs)
    found = scored(estimate, made, places(layout, made))
    near = [each for each in found if each.closes >= max(PROMISING, found[0].closes - NEAR)][:TRIED]
    if not near:
        return None
    progress("seeking its formula", 0, 0)
    length, area = plant.values["L_0"], plant.values["A"]
    formulas = [compress(estimate, made, with_terms(each.place, made, layout, length)) for each in near]
    able = [(each, f) for each, f in zip(near, formulas, strict=True) if f.chosen and writable(f, layout)]
    able.sort(key=lambda pair: -_worth(pair[1]))
    best: Invention | None = None
    try:
        for each, formula in able[:FITTED]:
            if best is not None and formula.closes < best.closes - NEAR:
                break
            progress(f"fitting a law of {formula.place.label}", 0, 0)
            found_here = _invention(estimate, known, each, formula, folder, source, judged, made)
            if found_here is not None and (best is None or found_here.closes > best.closes + 0.01 * len(formula.chosen)):
                best = replace(found_here, places=tuple(found))
    finally:  # nothing of what was only tried stays
        for _, formula in able[:FITTED]:
            name = write(formula, layout, area, source).name
            if best is None or name != best.written.name:
                unload_effect(name)
                (folder / f"{name}.py").unlink(missing_ok=True)
    return best


def _invention(
    estimate: ParameterEstimate, known: Model, scored: Scored, formula: Formula, folder: Path, source: str, judged: Sequence[Run],
    made: Sequence[Course],
) -> Invention | None:  # fmt: skip
    """A formula fitted through the simulation; None where the model cannot do the runs with it, or where it closes too little.

    Args:
        estimate, known, folder, source, judged: see `invent`.
        scored: the formula's place.
        formula: to first order.
        made: the runs as the estimate's model does them.
    """
    written = write(formula, made[0].model.layout, estimate.plant.values["A"], source)
    file = output_folder(folder) / f"{written.name}.py"
    fitted = _fitted(estimate, known, written, file)
    if fitted is None:
        return None
    before, after = _excess(estimate), leave_out(fitted, SearchSettings.of(fitted.plant)).excess
    closes = (before - after) / max(before, 1e-12)
    if closes < LEAST:
        return None
    model = replace(known, parameters=_changed(known, fitted), effects=_effects(known, written, fitted))
    runs = judged or estimate.problem.runs
    errors = error_on(estimate, runs), error_on(fitted, runs)
    return Invention(scored, formula, written, file, fitted, model, closes, errors, tuple(extrapolated(fitted, made, formula, judged)), ())


def _worth(formula: Formula) -> float:
    """Part of the structure that a formula predicts, less what its length costs."""
    return formula.closes - 0.01 * len(formula.chosen)


def _excess(estimate: ParameterEstimate) -> float:
    """Of what an estimate predicts of left-out data; its derivatives are taken anew."""
    residuals = estimate.problem.residuals(estimate.values)
    return leave_out(replace(estimate, residuals=residuals), SearchSettings.of(estimate.plant)).excess


def _fitted(estimate: ParameterEstimate, known: Model, written: Written, path: Path) -> ParameterEstimate | None:
    """The model with the law, fitted to the runs; None where it cannot do them."""
    write_atomically(path, written.text)
    load_effects([path])
    model = compile_model(replace(known, effects=(*known.effects, ActiveEffect(written.name, None, dict(written.start)))))
    plant = NetworkPlant(model, estimate.plant.static).with_values(
        {name: estimate.plant.values[name] for name in known.robot.parameters.model_dump()}
    )
    own = plant.free([f"{written.name}.{name}" for name in written.start])
    at = zip(estimate.problem.free, estimate.values, strict=True)
    problem = replace(estimate.problem, plant=plant, free=(*(replace(f, start=float(value)) for f, value in at), *own))
    try:
        return identify(problem, STEPS)
    except PredictionError:
        return None


def _changed(known: Model, fitted: ParameterEstimate) -> dict[str, float]:
    nominal = known.robot.parameters.model_dump()
    return {name: value for name, value in fitted.plant.values.items() if name in nominal and value != nominal[name]}


def _effects(known: Model, written: Written, fitted: ParameterEstimate) -> tuple[ActiveEffect, ...]:
    """The model's effects with the values found, and the law."""
    every = [*((effect.name, effect.detail) for effect in known.effects), (written.name, None)]
    return tuple(acting_effect(name, detail, fitted.plant.values, Layout.of(known.robot)) for name, detail in every)


def error_on(estimate: ParameterEstimate, runs: Sequence[Run]) -> float:
    """Root mean square of Eq. (5) in m."""
    points = [estimate.plant.predict(run, (), estimate.problem.step).points for run in runs]
    return error_over_time(np.concatenate([run.points for run in runs]), np.concatenate(points))


def extrapolated(fitted: ParameterEstimate, made: Sequence[Course], formula: Formula, judged: Sequence[Run]) -> list[Beyond]:
    """Runs in which a variable of the law leaves what the law was fitted over.

    Args:
        fitted: with the law.
        made: the runs fitted to, as the model does them.
        formula: of the law.
        judged: runs that were not fitted to.
    """
    plant, place = fitted.plant, formula.place
    if all(named(place, k).endswith("constant") for k in formula.chosen) or not isinstance(plant, NetworkPlant):
        return []
    layout = plant.model.layout
    found, asked = [], courses(plant, judged)
    for variable in filter(None, (place.variable, place.times)):

        def values(course: Course, variable: str = variable) -> np.ndarray:
            every = course.of(variable, layout)
            return every if variable == "time" else every[:, place.targets(layout)]

        low, high = (float(op([op(values(course)) for course in made])) for op in (np.min, np.max))
        room = BEYOND * (high - low)
        for course in asked:
            at = values(course)
            if at.min() < low - room or at.max() > high + room:
                found.append(Beyond(course.run.file, variable, float(at.min()), float(at.max()), (low, high)))
    return found

"""Find a law where no known effect fits: place, shortest formula, effect file, fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tepm_opt.data.files import output_folder, write_atomically
from tepm_opt.data.metrics import error_over_time
from tepm_opt.data.run import Run
from tepm_opt.discrepancy.adapters.network import acting_effect
from tepm_opt.discrepancy.problem.plant import as_network
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.cross_validation import leave_out
from tepm_opt.discrepancy.symbolic.formula import Formula, compress, name_term, with_terms
from tepm_opt.discrepancy.symbolic.places import Course, find_places
from tepm_opt.discrepancy.symbolic.responses import simulate_courses
from tepm_opt.discrepancy.symbolic.score import Scored, score_places
from tepm_opt.discrepancy.symbolic.settings import DEFAULT, SymbolicSettings
from tepm_opt.discrepancy.symbolic.writing import EffectFile, can_be_written, with_fitted_values, write
from tepm_opt.models.compile import compile_model
from tepm_opt.models.effect import ActiveEffect
from tepm_opt.models.effect_files import load_effects, unload_effect
from tepm_opt.models.layout import Layout
from tepm_opt.models.model import Model
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.identification.identify import ParameterEstimate, identify
from tepm_opt.solvers.mechanics.network_plant import NetworkPlant
from tepm_opt.solvers.mechanics.plant import PredictionError


@dataclass(frozen=True, eq=False)
class Extrapolation:
    """A run in which a variable of the law leaves the range that was visited; both ranges in its unit."""

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
        file: path of that.
        estimate: the model with the law, fitted.
        model: the same to go on with.
        closes: part of the structure left that it closes in left-out data.
        errors: root mean square of Eq. (5) in m on the runs judged: without the law and with it.
        beyond: runs in which it extrapolates.
        places: all places, the one that predicts most first.
    """

    scored: Scored
    formula: Formula
    written: EffectFile
    file: Path
    estimate: ParameterEstimate
    model: Model
    closes: float
    errors: tuple[float, float]
    beyond: tuple[Extrapolation, ...]
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
        return with_fitted_values(self.formula, self.written, self.estimate.plant.values)


def invent(
    estimate: ParameterEstimate, known: Model, folder: Path, source: str, judged: Sequence[Run] = (), progress: Progress = silent
) -> Invention | None:
    """Find a law for the residuals of an estimate and load its effect; None where no law at any place would predict them.

    Args:
        estimate: the best that known effects do, of a network.
        known: its model with those effects and their values; it has to have all free parameters of the estimate.
        folder: for the effect file.
        source: name of the data, for people.
        judged: runs that were not fitted to; those fitted to where there are none.
        progress: told of every piece of work.

    Raises:
        PredictionError: the model cannot do a run.
    """
    network, settings = as_network(estimate.plant), DEFAULT
    if network is None or estimate.cost <= (1 + settings.noise_excess) * estimate.count:
        return None
    progress("looking where a law may act", 0, 0)
    made = simulate_courses(network, estimate.problem.runs, settings)
    found = score_places(estimate, made, find_places(made, settings), settings)
    least = max(settings.min_promise, found[0].closes - settings.place_margin)
    near = [each for each in found if each.closes >= least][: settings.places_tried]
    if not near:
        return None
    progress("seeking its formula", 0, 0)
    formulas = [compress(estimate, made, with_terms(each.place, made, network.values["L_0"], settings), settings) for each in near]
    able = [(each, f) for each, f in zip(near, formulas, strict=True) if can_be_written(f)]
    able.sort(key=lambda pair: settings.term_cost * len(pair[1].chosen) - pair[1].closes)
    judge, tried, best = _Judge(estimate, known, folder, judged, made), [], None
    try:
        for each, formula in able[: settings.formulas_fitted]:
            if best is not None and formula.closes < best.closes - settings.place_margin:
                break
            progress(f"fitting a law of {formula.place.label}", 0, 0)
            tried.append(write(formula, network.model.layout, network.values["A"], source))
            law = judge.fit_and_judge(each, formula, tried[-1])
            if law is not None and (best is None or law.closes > best.closes + settings.term_cost * len(formula.chosen)):
                best = replace(law, places=tuple(found))
    finally:  # nothing of rejected formulas stays
        for written in tried:
            if best is None or written.name != best.written.name:
                unload_effect(written.name)
                (folder / f"{written.name}.py").unlink(missing_ok=True)
    return best


@dataclass(frozen=True, eq=False)
class _Judge:
    """Data and model by which formulas are fitted and judged, see `invent`; `made` are the runs fitted to, as the model does them."""

    estimate: ParameterEstimate
    known: Model
    folder: Path
    judged: Sequence[Run]
    made: Sequence[Course]

    def fit_and_judge(self, scored: Scored, formula: Formula, written: EffectFile) -> Invention | None:
        """Fit a formula through the simulation; None where the model cannot do the runs with it, or it closes too little."""
        estimate, known, file = self.estimate, self.known, output_folder(self.folder) / f"{written.name}.py"
        fitted = _fit(estimate, known, written, file, DEFAULT.fit_steps)
        if fitted is None:
            return None
        anew = replace(estimate, residuals=estimate.problem.residuals(estimate.values))  # with derivatives at the values
        search = SearchSettings.for_plant(fitted.plant)
        before, after = leave_out(anew, search).excess, leave_out(fitted, search).excess
        closes = (before - after) / max(before, 1e-12)
        if closes < DEFAULT.min_closed:
            return None
        nominal, values = known.robot.parameters.model_dump(), fitted.plant.values
        changed = {name: value for name, value in values.items() if name in nominal and value != nominal[name]}
        every = [*((effect.name, effect.detail) for effect in known.effects), (written.name, None)]
        effects = tuple(acting_effect(name, detail, values, Layout.from_robot(known.robot)) for name, detail in every)
        runs = self.judged or estimate.problem.runs
        errors = error_on(estimate, runs), error_on(fitted, runs)
        beyond = tuple(find_extrapolations(fitted, self.made, formula, self.judged))
        model = replace(known, parameters=changed, effects=effects)
        return Invention(scored, formula, written, file, fitted, model, closes, errors, beyond, ())


def _fit(estimate: ParameterEstimate, known: Model, written: EffectFile, path: Path, steps: int) -> ParameterEstimate | None:
    """The model with the law, fitted to the runs in so many steps at most; None where it cannot do them."""
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
        return identify(problem, steps)
    except PredictionError:
        return None


def error_on(estimate: ParameterEstimate, runs: Sequence[Run]) -> float:
    """Root mean square of Eq. (5) in m."""
    points = [estimate.plant.predict(run, (), estimate.problem.step).points for run in runs]
    return error_over_time(np.concatenate([run.points for run in runs]), np.concatenate(points))


def find_extrapolations(
    fitted: ParameterEstimate, made: Sequence[Course], formula: Formula, judged: Sequence[Run], settings: SymbolicSettings = DEFAULT
) -> list[Extrapolation]:
    """Runs in which a variable of the law leaves the range over which the law was fitted.

    Args:
        fitted: with the law.
        made: the runs fitted to, as the model does them.
        formula: of the law.
        judged: runs that were not fitted to.
        settings: of the search.
    """
    network, place = as_network(fitted.plant), formula.place
    if network is None or all(name_term(place, k).endswith("constant") for k in formula.chosen):
        return []
    found, asked = [], simulate_courses(network, judged, settings)
    for variable in filter(None, (place.variable, place.times)):
        at = slice(None) if variable == "time" else place.targets(network.model.layout)
        ranges = [(float(values.min()), float(values.max())) for values in (c.values_of(variable)[:, at] for c in (*made, *asked))]
        low, high = min(low for low, _ in ranges[: len(made)]), max(high for _, high in ranges[: len(made)])
        room = settings.range_margin * (high - low)
        for course, (least, most) in zip(asked, ranges[len(made) :], strict=True):
            if least < low - room or most > high + room:
                found.append(Extrapolation(course.run.file, variable, least, most, (low, high)))
    return found

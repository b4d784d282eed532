"""Tuning of the Kalman filter on a closed-loop log: the noise levels and the travel over which friction turns over whose predictions of the
tracked tip are best.

The controller uses what the filter predicts for the next 0.3 s, so candidates are compared by the mean squared prediction errors at 0.05,
0.15 and 0.30 s, weighted alike by their logarithms. The likelihood of the innovations, one period ahead, does not improve the closed loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from tepm_opt.control.estimation.kalman_filter import DEFAULT, DiscreteModalModel, Estimator, FilterSettings
from tepm_opt.errors import InputError
from tepm_opt.models.model import Model
from tepm_opt.progress import Progress, silent, track

HORIZONS = (0.05, 0.15, 0.30)  # s; the longest is the controller's prediction horizon
FRICTION_SCALES = (1.0, 0.3, 0.1)  # of the hand-set values; larger ones predicted worse in the study
STRENGTH_SCALES = (1.0, 0.3)  # 0.1 and 0.3 predict alike: less than 0.3 % apart
TRAVEL_SCALES = (1.0, 2.0, 4.0)  # of the hand-set distance; where half of it is right, it costs little
SOFTER = 0.15  # by which the criterion has to fall for the next of them: predictions alone say a little too long
MOST_TRAVEL = 3e-3  # m, up to which that of a model is taken; at least the hand-set one: instants of reversals are not known better
EXPLAINED_SCALE = 0.3  # of the hand-set uncertainty of the muscles' strength, with a model whose strengths data have shown
SETTLING = 1.5  # s from the start over which errors do not count
SHORTEST = 4.0  # s of a log: errors of 2.2 s at least count at the longest horizon


@dataclass(frozen=True, eq=False)
class FilterInputs:
    """Inputs of the filter over a run, the same for all its settings; an entry a control period.

    Attributes:
        operating: local models about the reference, (periods,).
        noise: of a tracked coordinate, 1 sigma in m, (periods,).
        points: tracked, (periods, points, 3) in m in G, NaN where missing.
        forces: known axial forces at start and end of each period, (periods − 1, 2, actuators) in N.
        tensions: at the motors, (periods − 1, actuators) in N.
        rates: of the actuators' lengths by the reference, (periods − 1, actuators) in m/s.
        middle: tension about which the motors work in N.
    """

    operating: Sequence[DiscreteModalModel]
    noise: np.ndarray
    points: np.ndarray
    forces: np.ndarray
    tensions: np.ndarray
    rates: np.ndarray
    middle: float


@dataclass(frozen=True)
class Candidate:
    """Scales with their prediction errors.

    Attributes:
        travel: factor on the distance over which friction turns over.
        friction: factor on standard deviation and drift of the dry friction.
        strength: factor on standard deviation and drift of the muscles' gain error.
        settings: of the filter with them.
        errors: tip's prediction error at `HORIZONS`, rms in m.
    """

    travel: float
    friction: float
    strength: float
    settings: FilterSettings
    errors: tuple[float, ...]

    @property
    def criterion(self) -> float:
        """Sum of the logarithms of the mean squared errors; less is better."""
        return float(2 * np.log(self.errors).sum())

    @property
    def hand_set(self) -> bool:
        """Whether it has the hand-set values."""
        return self.travel == self.friction == self.strength == 1.0


def scale_noise(settings: FilterSettings, friction: float, strength: float) -> FilterSettings:
    """Settings with dry friction and gain error less, or more, uncertain by a factor each."""
    return replace(
        settings,
        friction_std=friction * settings.friction_std, friction_drift=friction * settings.friction_drift,
        strength_std=strength * settings.strength_std, strength_drift=strength * settings.strength_drift,
    )  # fmt: skip


def settings_of_explained(model: Model, travel: float | None) -> Model:
    """A model that explains data with settings of the filter for it; settings that it has stay.

    Muscles' strengths are in it or were not needed, so that they are less uncertain.

    Args:
        model: of a verdict.
        travel: over which friction turns over in closed loop in m; None where data do not tell.
    """
    known = scale_noise(DEFAULT, 1.0, EXPLAINED_SCALE)
    found = {"strength_std": known.strength_std, "strength_drift": known.strength_drift}
    if travel is not None:
        found["presliding_distance"] = min(max(travel, DEFAULT.presliding_distance), MOST_TRAVEL)
    return replace(model, filter={**found, **model.filter})


def prediction_errors(inputs: FilterInputs, settings: FilterSettings) -> tuple[float, ...]:
    """Root mean square of the tip's prediction error at each of `HORIZONS` in m, by the filter's own transitions.

    Raises:
        InputError: the log is too short, or the tip was not tracked.
    """
    estimator, period = Estimator(inputs.operating[0], inputs.noise[0], inputs.middle, settings), inputs.operating[0].period
    count, skipped = len(inputs.points), round(SETTLING / period)
    if count * period < SHORTEST:
        raise InputError(f"{count * period:.2f} s of closed loop are too short for tuning; valid: at least {SHORTEST:g} s")
    means, A, push = [], [], []
    for k in range(count):
        estimator.noise = inputs.noise[k]
        estimator.update(inputs.points[k])
        means.append(estimator.mean)
        if k + 1 < count:
            done = estimator.predict(inputs.forces[k], inputs.tensions[k], inputs.rates[k], inputs.operating[k + 1])
            A.append(done.A)
            push.append(done.push)
    state, transitions, pushes, squares = np.array(means[skipped:]), np.array(A[skipped:]), np.array(push[skipped:]), []
    models, steps = [at.model for at in inputs.operating[skipped:]], [round(horizon / period) for horizon in HORIZONS]
    observe, modes = np.array([model.observe[-3:] for model in models]), models[0].observe.shape[1]
    seen = inputs.points[skipped:, -1] - np.array([model.equilibrium.points[-1] for model in models])
    for ahead in range(1, max(steps) + 1):
        state = (transitions[ahead - 1 :] @ state[:-1, :, None])[..., 0] + pushes[ahead - 1 :]
        if ahead in steps:
            missed = (observe[ahead:] @ state[:, :modes, None])[..., 0] + state[:, -3:] - seen[ahead:]
            squares.append((missed**2).sum(axis=1))
    if not all(np.isfinite(each).any() for each in squares):
        raise InputError(f"the tip was not tracked after {SETTLING:g} s; valid: a log with the tip's coordinates")
    return tuple(float(np.sqrt(np.nanmean(each))) for each in squares)


def compare_scales(
    inputs: FilterInputs, friction: tuple[float, float] | None, travel: float | None = None, progress: Progress = silent
) -> tuple[Candidate, ...]:
    """Candidates with their prediction errors, the hand-set values first: travels, then with the right one all pairs of noise levels.

    The travel of the model, or else the hand-set one, stays unless another of `TRAVEL_SCALES` is clearly better.

    Args:
        inputs: of the filter over a closed-loop run.
        friction: of the model's tendons, constant part in N and share of the tension; None without one.
        travel: over which friction turns over by the model in m; None where it does not say.
        progress: told of every candidate.

    Raises:
        InputError: the log is too short, or the tip was not tracked.
    """
    found: list[Candidate] = []

    def add(scale: float, pair: tuple[float, float]) -> None:
        settings = replace(scale_noise(DEFAULT, *pair), presliding_distance=scale * DEFAULT.presliding_distance)
        errors = prediction_errors(inputs, settings.with_friction_prior(friction, inputs.middle))
        found.append(Candidate(scale, *pair, settings, errors))

    own = 1.0 if travel is None else travel / DEFAULT.presliding_distance
    scales = tuple(dict.fromkeys((*TRAVEL_SCALES, own)))
    for scale in track(scales, progress, "travel of the friction", len(scales)):
        add(scale, (1.0, 1.0))
    right = found[scales.index(own)]
    for other in found:
        right = other if right.criterion - other.criterion > SOFTER else right
    pairs = list(product(FRICTION_SCALES, STRENGTH_SCALES))[1:]
    for pair in track(pairs, progress, "noise levels of the filter", len(pairs)):
        add(right.travel, pair)
    return tuple(found)

"""Alike parameters that scatter: their common spread is found with them (empirical Bayes)."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from scipy.stats import f, t

from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.identification.identify import ITERATIONS, ParameterEstimate, Problem, identify
from tepm_opt.solvers.mechanics.plant import Free

ROUNDS = 20
SETTLED = 0.02  # part of a spread by which it changes no more
SMALLEST = 1e-3  # of a parameter's scale, a spread that is none


def spreads(estimate: ParameterEstimate) -> dict[str, float]:
    """Spread of every group of parameters that the estimate makes likely, by the group's name, in the parameters' unit.

    A step of expectation maximisation: the mean square of how far the members are from their prior means, by their values and by what is
    not known of them (Dempster, Laird and Rubin, J. Royal Statistical Society B 39, 1977; Gelman et al., Bayesian Data Analysis, 2013,
    ch. 13).
    """
    squares: dict[str, list[float]] = {}
    for free, value, std in zip(estimate.problem.free, estimate.values, estimate.std, strict=True):
        if free.group:
            squares.setdefault(free.group, []).append(float((value - free.prior_mean) ** 2 + std**2))
    return {group: float(np.sqrt(np.mean(each))) for group, each in squares.items()}


def with_spreads(problem: Problem, found: dict[str, float]) -> Problem:
    """The problem with these spreads as the normal priors of the members of their groups."""

    def spread(free: Free) -> Free:
        return replace(free, prior_std=max(found[free.group], SMALLEST * free.scale)) if free.group in found else free

    return replace(problem, free=tuple(spread(free) for free in problem.free))


def compute_clustering_chances(estimate: ParameterEstimate, clusters: int, names: Collection[str]) -> list[float]:
    """Chance that members of a group, if they scatter about one mean, differ as much between clusters; one for every group.

    Fisher's F over the members' scatter within clusters, with what is not known of them; members of a cluster stand side by side.

    Args:
        estimate: with the groups.
        clusters: how many of equal size.
        names: of the parameters whose groups are asked for.
    """
    found = []
    for values, stds in _members(estimate, names):
        each = len(values) // clusters
        if clusters < 2 or each < 2 or each * clusters != len(values):
            continue
        parts = values.reshape(clusters, each)
        between = each * float(np.var(parts.mean(axis=1), ddof=1))
        within = float(np.mean(np.var(parts, axis=1, ddof=1)) + np.mean(stds**2))
        found.append(float(f.sf(between / max(within, 1e-300), clusters - 1, clusters * (each - 1))))
    return found


def off_centre(estimate: ParameterEstimate, names: Collection[str]) -> list[float]:
    """Chance that the mean of a group's members, if they scatter about their prior mean, is as far from it; one for every group.

    Student's t over their scatter, with what is not known of them, which all may have alike: what all members have is a cause of its own.

    Args:
        estimate: with the groups.
        names: of the parameters whose groups are asked for.
    """
    found = []
    for values, stds in _members(estimate, names):
        if len(values) > 1:
            doubt = float(np.var(values, ddof=1) / len(values) + np.mean(stds**2))
            apart = abs(float(values.mean())) / np.sqrt(max(doubt, 1e-300))
            found.append(float(2 * t.sf(apart, len(values) - 1)))
    return found


def _members(estimate: ParameterEstimate, names: Collection[str]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Distances of every group's members from their prior means, and their standard deviations, (members,) each."""
    members: dict[str, list[tuple[float, float]]] = {}
    for free, value, std in zip(estimate.problem.free, estimate.values, estimate.std, strict=True):
        if free.group and free.name in names:
            members.setdefault(free.group, []).append((float(value - free.prior_mean), float(std)))
    return [(np.array(values), np.array(stds)) for values, stds in (zip(*each, strict=True) for each in members.values())]


def identify_with_spreads(
    problem: Problem, max_iterations: int = ITERATIONS, progress: Progress = silent, tolerance: float = 1e-5
) -> ParameterEstimate:
    """Parameters and the spreads of their groups, in turn until the spreads change no more; without groups the same as `identify`.

    The spreads found are the `prior_std` of the estimate's free parameters.

    Args:
        problem: what to fit; its groups' `prior_std` are first guesses.
        max_iterations: most steps of every fit.
        progress: told of every step.
        tolerance: see `identify`.

    Raises:
        InputError: no runs, no parameters or no measured sample.
        PredictionError: the model cannot do the runs with the first values.
    """
    estimate = identify(problem, max_iterations, progress, tolerance)
    for _ in range(ROUNDS):
        found = spreads(estimate)
        before = {free.group: free.prior_std for free in estimate.problem.free}
        if all(abs(spread - before[group]) <= SETTLED * before[group] for group, spread in found.items()):
            break
        begun = tuple(replace(free, start=float(value)) for free, value in zip(estimate.problem.free, estimate.values, strict=True))
        estimate = identify(with_spreads(replace(problem, free=begun), found), max_iterations, progress, tolerance, near=True)
    return estimate

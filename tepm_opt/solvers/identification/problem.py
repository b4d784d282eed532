"""Least-squares problem: a plant, runs, free parameters, noise, and the residuals of values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.data.run import Run, thin_out
from tepm_opt.solvers.identification.initial_state import with_estimated_initial_state, without_start
from tepm_opt.solvers.identification.prior import JointPrior
from tepm_opt.solvers.identification.residuals import BLOCK, Residual
from tepm_opt.solvers.mechanics.plant import START, Free, Plant
from tepm_opt.solvers.numerics.parallel import in_parallel
from tepm_opt.solvers.numerics.text import format_names


@dataclass(frozen=True, eq=False)
class Problem:
    """The model, the runs and the free parameters of a fit.

    Attributes:
        plant: a model of the machine; its values hold for all that is not free.
        runs: to fit to.
        free: the parameters to be found.
        noise: of a coordinate, 1 sigma in m, or of each point, (points, 1); of all runs alike or of each.
        robust: whether outliers are weighted down (Huber's loss at 4 robust standard deviations of the residuals).
        step: longest time step of the simulations in s.
        derivatives_apart: time in s between the samples at which derivatives are taken, with straight lines between them; 0 takes them at
            every sample. Derivatives of a motion are smooth: 0.04 s leaves errors of 0.2 % as a rule, of some % where inputs jump.
        block: time in s after which residuals count as independent.
        joint: prior of several parameters together, besides those that each has for itself; None for none.
    """

    plant: Plant
    runs: tuple[Run, ...]
    free: tuple[Free, ...]
    noise: float | np.ndarray | tuple[float | np.ndarray, ...]
    robust: bool = False
    step: float = np.inf
    derivatives_apart: float = 0.0
    block: float = BLOCK
    joint: JointPrior | None = None

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Problem({len(self.runs)} runs, free: {format_names([free.name for free in self.free]) or 'nothing'})"

    def with_values(self, values: np.ndarray) -> Plant:
        """The model with these values of the free parameters."""
        return self.plant.with_values({free.name: float(value) for free, value in zip(self.free, values, strict=True)})

    @property
    def start(self) -> np.ndarray:
        """First values, (parameters,)."""
        return np.array([free.start for free in self.free])

    @property
    def low(self) -> np.ndarray:
        """Lower bounds, (parameters,)."""
        return np.array([free.low for free in self.free])

    @property
    def high(self) -> np.ndarray:
        """Upper bounds, (parameters,)."""
        return np.array([free.high for free in self.free])

    @property
    def scale(self) -> np.ndarray:
        """Small but visible changes, (parameters,)."""
        return np.array([free.scale for free in self.free])

    @property
    def prior(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean μ, (parameters,), and precision Λ, (parameters, parameters), of the normal priors: they cost (θ - μ)ᵀ Λ (θ - μ)."""
        mean = np.array([free.prior_mean for free in self.free])
        precision = np.diag(np.array([free.prior_std for free in self.free]) ** -2.0)
        if self.joint is None:
            return mean, precision
        shared, more = self.joint.terms(self.free)
        told = np.diag(more) > 0  # what earlier data tell includes what was known before them
        return np.where(told, shared, mean), np.where(np.outer(told, told), more, precision)

    @property
    def noises(self) -> tuple[float | np.ndarray, ...]:
        """Noise of each run."""
        return self.noise if isinstance(self.noise, tuple) else (self.noise,) * len(self.runs)

    def residuals(self, values: np.ndarray, names: Sequence[str] | None = None) -> list[Residual]:
        """Measured less modelled of every run, differentiated by `names` (the free ones where absent).

        Raises:
            PredictionError: the model cannot do a run with these values.
        """
        names = [free.name for free in self.free] if names is None else names
        plant = self.with_values(values)
        noise = self.noises
        if any(run.start != "equilibrium" for run in self.runs):
            return self._from_states(plant, names, noise)
        sparse = self.sparse if names else self
        work = [(self.step, run, names if sparse is self else ()) for run in self.runs]
        work += [(sparse.step, run, names) for run in sparse.runs if sparse is not self]
        found = in_parallel(
            lambda piece: plant.predict(piece[1], piece[2], piece[0]),
            work,
            lambda piece: piece[1].rows * (1 + len(piece[2])),
            plant.concurrent,
        )
        points, slopes = found[: len(self.runs)], found[-len(self.runs) :]
        return [
            Residual.from_prediction(run, modelled.points, change.by, sigma, at.time, self.block)
            for run, modelled, change, sigma, at in zip(self.runs, points, slopes, noise, sparse.runs, strict=True)
        ]

    def differentiate(self, values: np.ndarray, residuals: Sequence[Residual]) -> list[Residual]:
        """Residuals at these values with their derivatives by the free parameters.

        Raises:
            PredictionError: the model cannot do a run with these values.
        """
        sparse = self.sparse
        if sparse is self:
            return self.residuals(values)
        plant, names = self.with_values(values), [free.name for free in self.free]
        found = in_parallel(lambda run: plant.predict(run, names, sparse.step), sparse.runs, lambda run: run.rows, plant.concurrent)
        return [
            r.with_derivatives(run, change.by, sigma, at.time)
            for r, run, change, sigma, at in zip(residuals, self.runs, found, self.noises, sparse.runs, strict=True)
        ]

    def _from_states(self, plant: Plant, names: Sequence[str], noise: tuple[float | np.ndarray, ...]) -> list[Residual]:
        """Residuals of runs that begin with states of their own, each the best one for these parameters where it is free."""
        own = [START + name for name in plant.states]

        def find_residual(measured: tuple[Run, float | np.ndarray]) -> Residual:
            run, sigma = with_estimated_initial_state(plant, *measured, self.step), measured[1]
            free = own if run.start == "free" else []
            found = plant.predict(run, [*names, *free], self.step)
            residual = Residual.from_prediction(run, found.points, found.by, sigma, block=self.block)
            return without_start(residual, len(free)) if free else residual

        return in_parallel(find_residual, list(zip(self.runs, noise, strict=True)), lambda measured: measured[0].rows, plant.concurrent)

    @property
    def sparse(self) -> Problem:
        """The problem with only those samples at which derivatives are taken; this one where that is every one."""
        if self.plant.static or not self.derivatives_apart or any(run.start != "equilibrium" for run in self.runs):
            return self
        runs = tuple(thin_out(run, self.derivatives_apart) for run in self.runs)
        return replace(self, runs=runs, step=self.derivatives_apart, derivatives_apart=0.0)

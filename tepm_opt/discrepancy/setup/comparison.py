"""The misfit that a set-up hypothesis would leave, besides small errors of the model that are fitted to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.preparation.clock import find_time_shift
from tepm_opt.discrepancy.problem.plant import SearchablePlant
from tepm_opt.discrepancy.setup.hypotheses import SetupHypothesis
from tepm_opt.discrepancy.setup.settings import DEFAULT, SetupSettings
from tepm_opt.solvers.identification.initial_state import predictions, with_estimated_initial_state
from tepm_opt.solvers.mechanics.plant import Plant, PredictionError
from tepm_opt.solvers.numerics.least_squares import bounded_step
from tepm_opt.solvers.numerics.parallel import in_parallel


@dataclass(frozen=True, eq=False)
class Misfit:
    """Residuals over the noise with the nuisances fitted.

    Attributes:
        residuals: (rows, points, axes) a run; NaN where a sample is missing.
    """

    residuals: tuple[np.ndarray, ...]

    @property
    def mean_square(self) -> float:
        """Mean square over all coordinates."""
        return float(np.nanmean(np.concatenate([r.ravel() for r in self.residuals]) ** 2))

    def coefficient(self, mended: Misfit) -> tuple[float, float]:
        """Multiple of a mend's change that fits the residuals best, and its standard deviation by jackknife over parts of runs.

        It is 1 where the mend is right and 0 where there is nothing to mend, whatever else the model misses besides.
        """
        products, squares = [], []
        parts = max(2, -(-14 // len(self.residuals)))  # of a run: few runs would leave out all that a mend changes
        for before, after in zip(self.residuals, mended.residuals, strict=True):
            for old, new in zip(np.array_split(before, parts), np.array_split(after, parts), strict=True):
                change = old - new
                products.append(np.nansum(old * change))
                squares.append(np.nansum(change**2))
        total, size = np.sum(products), max(float(np.sum(squares)), 1e-300)
        alone = [(total - p) / max(size - q, 1e-12 * size) for p, q in zip(products, squares, strict=True)]
        return float(total / size), float(np.sqrt((len(alone) - 1) * np.var(alone)))


@dataclass(frozen=True, eq=False)
class Comparison:
    """Runs beside the nominal model's predictions, at a few samples of each run.

    Attributes:
        plant: the model without candidates.
        still: the same for equilibria; None where hypotheses are screened by full simulations.
        runs: as recorded.
        rows: numbers of the compared samples of each run.
        noise: of the measurements, 1 sigma per axis or of each point.
        motions: points of the nominal model at all samples.
        points: the same at the compared samples.
        nuisances: derivatives by what may be off besides, over its size, (rows, points, axes, nuisances) a run.
        limits: largest inputs.
        settings: thresholds.
    """

    plant: Plant
    still: Plant | None
    runs: tuple[Run, ...]
    rows: tuple[np.ndarray, ...]
    noise: float | np.ndarray
    motions: tuple[np.ndarray, ...]
    points: tuple[np.ndarray, ...]
    nuisances: tuple[np.ndarray, ...]
    limits: np.ndarray
    settings: SetupSettings = DEFAULT

    @staticmethod
    def simulate(
        plant: SearchablePlant, runs: Sequence[Run], noise: float | np.ndarray, settings: SetupSettings = DEFAULT,
        spreads: Mapping[str, float] | None = None,
    ) -> Comparison:  # fmt: skip
        """Simulate the runs with the nominal model.

        Args:
            plant: the model.
            runs: as recorded.
            noise: of the measurements, 1 sigma per axis in the unit of the points, or of each point, (points, 1).
            settings: thresholds.
            spreads: standard deviations of known parameters by full name, where more is known of them than the plant says.

        Raises:
            PredictionError: the model cannot do the runs as they are.
        """
        plain, still = plant.without_candidates, plant.equilibria
        rows = tuple(np.unique(np.linspace(0, run.rows - 1, min(settings.rows, run.rows)).round().astype(int)) for run in runs)
        spread = {free.name: free.spread for free in plain.free(plant.known)} | dict(spreads or {})
        motions, nuisances = [], []
        step = np.inf if still is None else settings.sample_spacing
        predicted = in_parallel(
            lambda run: plain.predict(with_estimated_initial_state(plain, run, noise), plant.known, step), runs, threads=plain.concurrent
        )
        for run, at, found in zip(runs, rows, predicted, strict=True):
            motions.append(found.points)
            columns = [spread[name] * by for name, by in zip(plant.known, found.by, strict=True)]
            columns += _frame_and_clock(run, found.points, noise, plain.static, settings)
            nuisances.append(np.stack(columns, axis=-1)[at])
        points = tuple(motion[at] for motion, at in zip(motions, rows, strict=True))
        return Comparison(plain, still, tuple(runs), rows, noise, tuple(motions), points, tuple(nuisances), plant.signals.ranges, settings)

    @property
    def thinned(self) -> tuple[Run, ...]:
        """The runs at the compared samples."""
        return tuple(take_rows(run, at) for run, at in zip(self.runs, self.rows, strict=True))

    @property
    def motion_mean_square(self) -> float:
        """Mean square over the noise's of the measured places about the mean of each."""
        measured = np.concatenate([run.points for run in self.thinned])
        present = np.isfinite(measured)
        mean = np.where(present, measured, 0.0).sum(axis=0) / np.maximum(present.sum(axis=0), 1)
        return float(np.nanmean(((measured - mean) / self.noise) ** 2))

    def misfit(self) -> Misfit:
        """Residuals of the runs as recorded."""
        return self._fit_nuisances([run.points - p for run, p in zip(self.thinned, self.points, strict=True)], self.nuisances)

    def misfit_with(self, hypothesis: SetupHypothesis) -> Misfit | None:
        """Residuals of the mended runs, with the nuisances of the recorded ones; None where the model cannot do them."""
        points: Sequence[np.ndarray] = self.points
        if hypothesis.changes != "points":
            whole = [self.within_limits(hypothesis.apply(run)) for run in self.runs]
            step = np.inf if self.still is None else self.settings.sample_spacing
            try:
                found = predictions(self.plant, whole, self.noise, step)
            except PredictionError:
                return None
            points = [prediction.points[at] for prediction, at in zip(found, self.rows, strict=True)]
        mended = [hypothesis.apply(run) for run in self.thinned]
        return self._fit_nuisances([run.points - p for run, p in zip(mended, points, strict=True)], self.nuisances)

    def least_on_another_clock(self) -> float:
        """Least mean square that is left where the positions of all runs, or of one of them, are taken to be late or early."""
        if self.plant.static:
            return np.inf
        shifts = [find_time_shift([run], [motion], self.noise) for run, motion in zip(self.runs, self.motions, strict=True)]
        alone = [shift.seconds if shift.parts else 0.0 for shift in shifts]
        together = find_time_shift(self.runs, self.motions, self.noise).seconds if any(shift.parts for shift in shifts) else 0.0
        choices = [np.full(len(alone), together), *np.diag(alone)]
        return min((self._misfit_late(seconds).mean_square for seconds in choices if np.any(seconds)), default=np.inf)

    def _misfit_late(self, seconds: np.ndarray) -> Misfit:
        """Residuals where the positions of each run trail the model's by so many seconds, (runs,)."""
        left = []
        for run, motion, at, late in zip(self.thinned, self.motions, self.rows, seconds, strict=True):
            time = self.runs[len(left)].time
            columns = [np.interp(time[at] - late, time, column) for column in motion.reshape(len(motion), -1).T]
            left.append(run.points - np.stack(columns, axis=1).reshape(run.points.shape))
        return self._fit_nuisances(left, self.nuisances)

    def screen(self, hypotheses: Sequence[SetupHypothesis]) -> list[tuple[float, SetupHypothesis]]:
        """Hypotheses by the part of the misfit that they would leave, to first order of the motion; least first."""
        slow = [_slowest(points, self.settings.slow_rows) for points in self.points]
        runs = [take_rows(run, at) for run, at in zip(self.thinned, slow, strict=True)]
        points = [p[at] for p, at in zip(self.points, slow, strict=True)]
        nuisances = [n[at] for n, at in zip(self.nuisances, slow, strict=True)]
        if self.still is None:  # the full simulations that follow are at all samples
            runs, points, nuisances = list(self.thinned), list(self.points), list(self.nuisances)
        there = self._fit_nuisances([run.points - p for run, p in zip(runs, points, strict=True)], nuisances).mean_square
        rest = None if self.still is None else [self.still.predict(run).points for run in runs]
        found = []
        for hypothesis in hypotheses:
            if not self._is_possible(hypothesis):
                continue
            if hypothesis.changes == "points":
                left = self._fit_nuisances([hypothesis.apply(run).points - p for run, p in zip(runs, points, strict=True)], nuisances)
            elif rest is None or self.still is None:
                left = self.misfit_with(hypothesis)
            else:
                try:
                    moved = [self.still.predict(self.within_limits(hypothesis.apply(run))).points for run in runs]
                except PredictionError:
                    continue
                left = self._fit_nuisances(
                    [run.points - p - m + s for run, p, m, s in zip(runs, points, moved, rest, strict=True)], nuisances
                )
            if left is not None:
                found.append((left.mean_square / max(there, 1e-300), hypothesis))
        return sorted(found, key=lambda each: each[0])

    def _is_possible(self, hypothesis: SetupHypothesis) -> bool:
        """Whether the mended inputs differ from the recorded ones, are within the limits, and are visible beside them."""
        if hypothesis.changes == "points":
            return True
        mended = [hypothesis.apply(run) for run in self.runs]
        finite = np.isfinite(self.limits)
        limits = np.where(finite, self.limits, 0.0)
        if not self._are_within_limits(mended):
            return False
        if len(hypothesis.columns) == 1 and hypothesis.shrinks(self.runs) and self._are_within_limits(self.runs):
            return False  # a weak actuator, of which there are more than of wrong units in one channel
        if hypothesis.kind == "scaled_channel" and finite.all():
            peaks = np.max([np.abs(run.inputs).max(axis=0) for run in mended], axis=0)
            if (peaks / limits)[list(hypothesis.columns)].max() < 0.02:
                return False
        return any(
            not np.array_equal(run.inputs, other.inputs) or not np.array_equal(run.tip_force, other.tip_force)
            for run, other in zip(self.runs, mended, strict=True)
        )

    def _are_within_limits(self, runs: Sequence[Run]) -> bool:
        """Whether no input leaves its limits by more than 2 %."""
        finite = np.isfinite(self.limits)
        limits = self.limits[finite]
        inputs = [run.inputs[:, finite] for run in runs]
        return not any((values > 1.02 * limits).any() or (values < -0.02 * limits).any() for values in inputs)

    def within_limits(self, run: Run) -> Run:
        """The run with inputs that leave the limits by a little put on them."""
        finite = np.isfinite(self.limits)
        return replace(run, inputs=np.clip(run.inputs, np.where(finite, 0.0, -np.inf), self.limits))

    def _fit_nuisances(self, residuals: Sequence[np.ndarray], nuisances: Sequence[np.ndarray]) -> Misfit:
        """Residuals over the noise once the nuisances are fitted, each at most `max_nuisance` times its size."""
        left = [r / self.noise for r in residuals]
        by = [n / np.asarray(self.noise)[..., None] for n in nuisances]
        seen = np.isfinite(np.concatenate([r.ravel() for r in left]))
        columns = np.concatenate([n.reshape(-1, n.shape[-1]) for n in by])[seen]
        bound = np.full(columns.shape[1], self.settings.max_nuisance)
        values = np.concatenate([r.ravel() for r in left])[seen]
        step, _ = bounded_step(columns.T @ columns, columns.T @ values, -bound, bound, np.ones(len(bound)))
        return Misfit(tuple(r + n @ step for r, n in zip(left, by, strict=True)))


def _frame_and_clock(run: Run, points: np.ndarray, noise: float | np.ndarray, static: bool, settings: SetupSettings) -> list[np.ndarray]:
    """Nuisances of the measurement: a late clock, a shifted and a slightly turned frame.

    Args:
        run: with the times.
        points: of the nominal model, (rows, points, axes).
        noise: of the measurements, 1 sigma per axis, or of each point, (points, 1).
        static: whether rows are equilibria.
        settings: sizes of the nuisances.
    """
    increasing = not static and run.rows > 1 and bool(np.all(np.diff(run.time) > 0))
    found = [settings.lag * np.gradient(points, run.time, axis=0)] if increasing else [np.zeros_like(points)]
    axes = points.shape[2]
    if axes == 3:
        found += [settings.shift * np.broadcast_to(e, points.shape) for e in np.eye(3)]
        return found + [settings.turn * np.cross(e, points) for e in np.eye(3)]
    size = 3 * np.broadcast_to(noise, points.shape)  # a zero error of each quantity
    return found + [np.where(np.arange(points.shape[1])[:, None] == k, size, 0.0) for k in range(points.shape[1])]


def _slowest(points: np.ndarray, stretches: int) -> np.ndarray:
    """Numbers of the slowest sample of each stretch of a run, (stretches,)."""
    if len(points) < 2:
        return np.arange(len(points))
    speed = np.abs(np.gradient(points, axis=0)).max(axis=(1, 2))
    parts = np.array_split(np.arange(len(points)), min(stretches, len(points)))
    return np.array([part[int(np.argmin(speed[part]))] for part in parts])


def take_rows(run: Run, rows: np.ndarray) -> Run:
    """Some rows of a run."""
    return replace(
        run, time=run.time[rows], inputs=run.inputs[rows], tip_force=run.tip_force[rows], points=run.points[rows],
        extra={name: values[rows] for name, values in run.extra.items()}, lines=(),
    )  # fmt: skip

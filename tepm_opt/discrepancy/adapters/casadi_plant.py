"""A machine given by equations, simulated with its sensitivities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.adapters.inputs import Between, append_delayed, inputs_at_steps, refine_time_grid, sample_steps
from tepm_opt.discrepancy.adapters.motion import Motion
from tepm_opt.discrepancy.problem.parameters import DescribedPlant
from tepm_opt.solvers.mechanics.plant import START, Prediction, PredictionError
from tepm_opt.solvers.numerics.parallel import give_way


@dataclass(frozen=True, eq=False)
class CasadiPlant(DescribedPlant):
    """A machine given by equations, see `solvers.mechanics.plant.Plant` and `plant.SearchablePlant`; made by `equations.Equations`.

    Attributes:
        motion: its equations.
        guess: of the states at rest, or at the start of a run.
        substeps: Runge-Kutta steps from sample to sample; more of them where samples are missing, none much longer than usual.
        between: course of inputs from sample to sample: constant ("hold"), linear ("line"), or free of frequencies above half the
            sampling rate ("band").
    """

    motion: Motion
    guess: Mapping[str, float]
    substeps: int = 1
    between: Between = "line"

    concurrent = True
    static = False
    quick = True
    derivatives_apart, modules = 0.0, 1

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"CasadiPlant({self.name}, {len(self.motion.states)} states, {len(self.candidates)} effects)"

    @property
    def operations(self) -> int:
        """Arithmetic operations of one evaluation of the rates, without effects."""
        motion = self._active_motion(())
        return int(ca.Function("rates", [motion.x, motion.u, motion.theta, motion.h], [motion.rates]).n_instructions())

    @property
    def states(self) -> dict[str, float]:
        """The states that a run may begin with, with a guess of each; last the delayed inputs before the run."""
        own = {name: self.guess[name] for name in self.motion.free_states}
        acting = self._active_effects(())
        return own | {each.before.name(): 0.0 for each in self.motion.late if each.label in acting}

    def _active_effects(self, by: Sequence[str]) -> frozenset[str]:
        """Labels of the effects that do not vanish, or by whose strength something is differentiated."""
        return frozenset(
            c.label
            for c in self.candidates
            if any(name in by or self.parameters[name].start != c.null[name] for name in c.parameters if name not in c.shapes)
        )

    def _active_motion(self, by: Sequence[str]) -> Motion:
        """The equations with the active effects only."""
        return self.motion.restrict_to(self._active_effects(by))

    def predict(self, run: Run, by: Sequence[str] = (), step: float = np.inf) -> Prediction:
        """Outputs of a run, from its initial state or from rest.

        Args:
            run: inputs and times.
            by: parameters by full name, or `START` + a state's name, by which to differentiate.
            step: ignored: steps are parts of those from sample to sample.

        Raises:
            PredictionError: no equilibrium to begin from, or a motion without bounds.
        """
        motion = self._active_motion(by)
        if run.state is not None and len(run.state) > len(motion.free_states):
            motion = motion.with_free_past
        return replace(self, motion=motion)._simulate(run, by)

    def _simulate(self, run: Run, by: Sequence[str]) -> Prediction:
        """Outputs of a run with all effects of the equations, see `predict`."""
        names = list(self.of_run(run).values())
        theta = np.array([self.parameters[name].start for name in names])
        chosen = tuple(names.index(name) if name in names else -1 for name in by)  # not states, nor parameters of other groups of runs
        turned = np.zeros((len(theta), len(by)))
        for k, number in enumerate(chosen):
            turned[number, k] = number >= 0
        time, inputs, rows = refine_time_grid(run, self.between)
        steps = sample_steps(time) / self.substeps
        h = float(steps[0]) if len(steps) else 1.0  # a single sample has no step
        seconds = np.asarray(self.motion.dead_times(theta)).ravel() if self.motion.late else ()
        late = [(each.number, float(ago)) for each, ago in zip(self.motion.late, seconds, strict=True)]
        u = append_delayed(inputs, time, late)[0]
        x, moved = self._initial_state(run, u, theta, turned, by, h)
        y, by_x, by_theta = (np.asarray(part) for part in self.motion.output(x, u, theta, h))
        points, change = np.empty((len(time), len(y))), np.zeros((len(time), len(by), len(y)))
        points[0], change[0] = y.ravel(), (by_x @ moved + by_theta @ turned).T
        give_way()
        if len(steps):
            whole = self.motion.simulation(chosen, self.substeps, len(steps))
            at_steps = inputs_at_steps(time, inputs, late, self.between, self.substeps)
            _, _, ys, d_ys = whole(x, moved, at_steps.T, theta, steps[None])
            points[1:] = np.asarray(ys).T
            if by:
                change[1:] = np.asarray(d_ys).reshape(len(y), len(steps), len(by)).transpose(1, 2, 0)
        diverged, overflows = 1e12, 1e100  # squares of derivatives beyond the latter exceed what a float holds
        if not (np.abs(points).max() < diverged and np.abs(change).max(initial=0.0) < overflows):
            raise PredictionError(f"{run.file}: the motion has no bounds; where only its steps are too long, plant(substeps=…) helps")
        return Prediction(points[rows][..., None], np.moveaxis(change[rows], 1, 0)[..., None])

    def _initial_state(
        self, run: Run, u: np.ndarray, theta: np.ndarray, turned: np.ndarray, by: Sequence[str], h: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """State at the first sample, with these inputs, and its change along the directions."""
        states = self.motion.states
        x, moved = np.array([self.guess[name] for name in states]), np.zeros((len(states), len(by)))
        free = [states.index(name) for name in self.states if name in self.motion.free_states]
        if run.state is None:
            by_theta = self._find_rest(run, u, x, free, theta, h)
            moved[free] = by_theta @ turned
        else:
            x[free] = run.state[: len(free)]
            for k, name in enumerate(by):
                if name.startswith(START):
                    moved[states.index(name.removeprefix(START)), k] = 1.0
        x, moved = (np.asarray(part) for part in self.motion.initial_change(len(by))(x, moved, u, theta, turned, h))
        return x.ravel(), moved

    def _find_rest(self, run: Run, u: np.ndarray, x: np.ndarray, free: list[int], theta: np.ndarray, h: float) -> np.ndarray:
        """Bring the free states of x to rest under the first inputs; return their change with θ, (free states, parameters)."""
        if not free:
            return np.zeros((0, len(theta)))
        rates, by_x, by_theta = (np.asarray(part) for part in self.motion.initial_rates(x, u, theta, h))
        size, most = np.abs(x[free]), np.abs(rates)
        for _ in range(50):  # steps of Newton's method at most
            change, _ = _solve_scaled(by_x, -rates.ravel())
            x[free] += change
            rates, by_x, by_theta = (np.asarray(part) for part in self.motion.initial_rates(x, u, theta, h))
            size, most = np.fmax(size, np.abs(change)), np.fmax(most, np.abs(rates))
            if (np.abs(change) <= 1e-10 * size).all():  # nothing but rounding is left
                break
        floor = self._negligible_rates(run, by_x, by_theta)
        still = (np.abs(rates) <= np.fmax(1e-6 * np.fmax(most, np.abs(by_x) @ size[:, None]), floor)).all()
        if not still or _solve_scaled(by_x, -rates.ravel())[1] < len(free):
            what = "comes to rest wherever it is" if still else "does not come to rest"
            raise PredictionError(f'{run.file}: {self.name} {what} under the first inputs; valid: start = "measured" or "free"')
        return -np.linalg.solve(by_x, by_theta)

    def _negligible_rates(self, run: Run, by_x: np.ndarray, by_theta: np.ndarray) -> np.ndarray:
        """Rates of the free states at which a run is at rest all the same, (free states, 1) per s.

        They are a millionth of what visible changes of the parameters do to a rate, or would move a state over the whole run by a millionth
        of what such changes do to it at rest. A relative tolerance alone would refuse states that are zero but for rounding.
        """
        visible = np.array([[self.parameters[name].scale] for name in self.of_run(run).values()])
        rates = np.abs(by_theta) @ visible
        moved = np.abs(_solve_scaled(by_x, rates.ravel())[0])[:, None]
        seconds = float(np.ptp(run.time)) if run.rows > 1 else 1.0
        return np.nan_to_num(1e-6 * np.fmax(rates, moved / seconds), posinf=0.0)


def _solve_scaled(matrix: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, int]:
    """Solve a least-squares problem whose rows and columns may have any units; also return the rank of the matrix."""
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        return np.full(len(right), np.nan), 0
    rows = np.abs(matrix).max(axis=1, keepdims=True)
    rows[rows == 0] = 1.0
    columns = np.abs(matrix / rows).max(axis=0)
    columns[columns == 0] = 1.0
    found, _, rank, _ = np.linalg.lstsq(matrix / rows / columns, right / rows[:, 0], rcond=1e-12)
    return found / columns, int(rank)

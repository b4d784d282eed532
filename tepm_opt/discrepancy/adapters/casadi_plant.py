"""A machine given by ẋ = f(x, u, θ), y = h(x, u, θ), simulated with its sensitivities."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, wraps
from threading import RLock
from typing import Literal, ParamSpec, TypeVar

import casadi as ca
import numpy as np
from scipy.signal import resample_poly

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.adapters.delays import SYMBOLS, DeadTime, Late, with_past
from tepm_opt.discrepancy.problem.parameters import Described
from tepm_opt.solvers.parallel import give_way
from tepm_opt.solvers.plant import START, Prediction, PredictionError

Between = Literal["hold", "line", "band"]
Asked = ParamSpec("Asked")
Made = TypeVar("Made")
BUILDING = RLock()
NEWTON_STEPS, AT_REST = 50, 1e-10
MOST = 1000  # times the usual steps that a run with all its gaps may last
BOUND = 1e12  # what is beyond it has diverged
STEEP = 1e100  # derivatives beyond it have squares that no float holds


def built(make: Callable[Asked, Made]) -> Callable[Asked, Made]:
    """The same function for several threads: expressions of CasADi's share what two threads must not make at a time."""

    @wraps(make)
    def alone(*args: Asked.args, **kwargs: Asked.kwargs) -> Made:
        with BUILDING:
            return make(*args, **kwargs)

    return alone


@dataclass(frozen=True, eq=False)
class Motion:
    """The equations.

    Attributes:
        states: names of x.
        x, rates: states and their rates.
        u, y: inputs, with the symbols of each dead time behind them, and what is measured.
        theta: all parameters.
        h: time step in s.
        settled: states that begin as a signal does, with that signal; later ones may depend on earlier ones.
        switches: of effects by label: 1 where one acts, 0 where it leaves everything as it is.
        late: dead times of inputs.
    """

    states: tuple[str, ...]
    x: ca.SX
    rates: ca.SX
    u: ca.SX
    y: ca.SX
    theta: ca.SX
    h: ca.SX
    settled: tuple[tuple[str, ca.SX], ...]
    switches: Mapping[str, ca.SX] = field(default_factory=dict)
    late: tuple[DeadTime, ...] = ()

    def of(self, acting: Collection[str]) -> Motion:
        """The equations with these effects only, without states on which nothing that is measured depends: a fraction of the work."""
        switches, on = ca.vertcat(*self.switches.values()), ca.DM([label in acting for label in self.switches])
        names, signals = [name for name, _ in self.settled], [signal for _, signal in self.settled]
        rates, y, *signals = ca.substitute([self.rates, self.y, *signals], [switches], [on])
        settled = dict(zip(names, signals, strict=True))
        needed, asked = set(), [name for name in self.states if name not in settled] + self._named(y)
        while asked:
            name = asked.pop()
            if name not in needed:
                needed.add(name)
                asked += self._named(ca.vertcat(rates[self.states.index(name)], settled.get(name, 0)))
        states = tuple(name for name in self.states if name in needed)
        rows = [self.states.index(name) for name in states]
        left = tuple((name, signal) for name, signal in settled.items() if name in needed)
        x, rates = (ca.vertcat(ca.SX(0, 1), *(column[row] for row in rows)) for column in (self.x, rates))
        late = tuple(each for each in self.late if each.label in acting)
        commands = self.u[: self.u.shape[0] - SYMBOLS * len(self.late)]
        u = ca.vertcat(commands, *(symbol for each in late for symbol in each.symbols))
        return Motion(states, x, rates, u, y, self.theta, self.h, left, late=late)

    def _named(self, value: ca.SX) -> list[str]:
        """The states on which a value depends."""
        return [name for name, there in zip(self.states, ca.which_depends(value, self.x, 1, False), strict=True) if there]

    @cached_property
    def free_states(self) -> tuple[str, ...]:
        """Names of the states that do not begin as a signal does."""
        taken = {name for name, _ in self.settled}
        return tuple(name for name in self.states if name not in taken)

    @cached_property
    def with_free_past(self) -> Motion:
        """The equations for a run whose inputs before its first sample are part of the state that it begins with."""
        past = {each.before.name() for each in self.late}
        return replace(self, settled=tuple((name, signal) for name, signal in self.settled if name not in past))

    @cached_property
    @built
    def dead_times(self) -> ca.Function:
        """θ → the dead times in s, (dead times,)."""
        return ca.Function("dead_times", [self.theta], [ca.vertcat(ca.SX(0, 1), *(each.time for each in self.late))])

    @cached_property
    @built
    def begin(self) -> ca.Function:
        """(x, u, θ) → x with the states that begin as a signal does where they begin."""
        x = list(ca.vertsplit(self.x))
        for name, signal in self.settled:
            at = self.states.index(name)
            x[at] = ca.substitute([signal], [self.x], [ca.vertcat(*x)])[0]
        return ca.Function("begin", [self.x, self.u, self.theta, self.h], [ca.vertcat(ca.SX(0, 1), *x)])

    @cached_property
    @built
    def rest(self) -> ca.Function:
        """(x, u, θ) → rates of the free states with their derivatives by them and by θ, all others where they begin."""
        free = [self.states.index(name) for name in self.free_states]
        rates = ca.substitute([self.rates], [self.x], [self.begin(self.x, self.u, self.theta, self.h)])[0][free]
        jacobians = [ca.jacobian(rates, self.x)[:, free], ca.jacobian(rates, self.theta)]
        return ca.Function("rest", [self.x, self.u, self.theta, self.h], [rates, *jacobians])

    @cached_property
    @built
    def measured(self) -> ca.Function:
        """(x, u, θ) → what is measured, with its derivatives by x and θ."""
        jacobians = [ca.jacobian(self.y, self.x), ca.jacobian(self.y, self.theta)]
        return ca.Function("measured", [self.x, self.u, self.theta, self.h], [self.y, *jacobians])

    def sampled(self, chosen: tuple[int, ...], substeps: int) -> ca.Function:
        """(x, its change along the directions, inputs, θ, time step) → x a sample later, ….

        Along a direction one of θ changes, the one of this number; none where it is negative.

        The outcome is x and its change, and what is measured and its change. Runge-Kutta of order 4 in so many equal steps; within a step
        inputs go in straight lines. Inputs are those at the steps' ends and, last, at the sample.
        """
        x, theta, h = self.x, self.theta, self.h
        inputs = self.u.shape[0]
        first, last = ca.SX.sym("u_0", inputs), ca.SX.sym("u_1", inputs)
        field = ca.Function("field", [x, self.u, theta, h], [self.rates])
        middle = (first + last) / 2
        k_1 = field(x, first, theta, h)
        k_2 = field(x + h / 2 * k_1, middle, theta, h)
        k_3 = field(x + h / 2 * k_2, middle, theta, h)
        k_4 = field(x + h * k_3, last, theta, h)
        after = x + h / 6 * (k_1 + 2 * k_2 + 2 * k_3 + k_4)
        moved, turned = ca.SX.sym("dx", x.shape[0], len(chosen)), ca.SX(theta.shape[0], len(chosen))
        for direction, number in enumerate(chosen):
            if number >= 0:
                turned[number, direction] = 1.0
        step = ca.Function("step", [x, moved, first, last, theta, h], [after, _along(after, x, theta, moved, turned)])
        seen = ca.Function("seen", [x, moved, self.u, theta, h], [self.y, _along(self.y, x, theta, moved, turned)])
        u = ca.SX.sym("u", inputs * (substeps + 2))
        at, change, now = x, moved, u[:inputs]
        for k in range(substeps):
            then = u[(k + 1) * inputs : (k + 2) * inputs]
            at, change = step(at, change, now, then, theta, h)
            now = then
        return ca.Function("sampled", [x, moved, u, theta, h], [at, change, *seen(at, change, u[-inputs:] if inputs else now, theta, h)])


def _along(value: ca.SX, x: ca.SX, theta: ca.SX, moved: ca.SX, turned: ca.SX) -> ca.SX:
    """Change of a value where x and θ change."""
    if not moved.shape[1]:
        return ca.SX(value.shape[0], 0)
    return ca.jtimes(value, ca.vertcat(x, theta), ca.vertcat(moved, turned))


@dataclass(frozen=True, eq=False)
class CasadiPlant(Described):
    """A machine given by equations, see `solvers.plant.Plant` and `plant.SearchablePlant`; made by `equations.Equations`.

    Attributes:
        motion: its equations.
        guess: of the states at rest, or where a run begins.
        substeps: Runge-Kutta steps from sample to sample; where samples are missing, more of them, none much longer than usual.
        between: how inputs go from sample to sample: they stay ("hold"), go in straight lines ("line"), or have nothing faster than half
            the samples' rate ("band").
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
    def states(self) -> dict[str, float]:
        """The states that a run may begin with, with a guess of each; last what inputs with a dead time were before."""
        own = {name: self.guess[name] for name in self.motion.free_states}
        acting = self._labels(())
        return own | {each.before.name(): 0.0 for each in self.motion.late if each.label in acting}

    def _acting(self, by: Sequence[str]) -> CasadiPlant:
        """The machine without the effects that vanish and by whose strength nothing is differentiated."""
        return replace(self, motion=_reduced(self.motion, self._labels(by)))

    def _labels(self, by: Sequence[str]) -> frozenset[str]:
        """The effects that do not vanish, or by whose strength something is differentiated."""
        return frozenset(
            c.label
            for c in self.candidates
            if any(name in by or self.parameters[name].start != c.null[name] for name in c.parameters if name not in c.shapes)
        )

    def predict(self, run: Run, by: Sequence[str] = (), step: float = np.inf) -> Prediction:
        """What a run should have measured, from the state it begins with or from rest.

        Args:
            run: what was done.
            by: parameters by full name, or `START` + a state's name, by which to differentiate.
            step: of no consequence: steps are parts of those from sample to sample.

        Raises:
            PredictionError: no equilibrium to begin from, or a motion without bounds.
        """
        acting = self._acting(by)
        if run.state is not None and len(run.state) > len(acting.motion.free_states):
            acting = replace(acting, motion=acting.motion.with_free_past)
        return acting._predicted(run, by)

    def _predicted(self, run: Run, by: Sequence[str]) -> Prediction:
        names = list(self.of_run(run).values())
        theta = np.array([self.parameters[name].start for name in names])
        chosen = tuple(names.index(name) if name in names else -1 for name in by)  # not states, nor parameters of other groups of runs
        turned = np.zeros((len(theta), len(by)))
        for k, number in enumerate(chosen):
            turned[number, k] = number >= 0
        time, inputs, rows = self._grid(run)
        steps = self._steps(time)
        h = float(steps[0]) if len(steps) else 1.0  # a single sample has no step
        seconds = np.asarray(self.motion.dead_times(theta)).ravel() if self.motion.late else ()
        late = [(each.number, float(ago)) for each, ago in zip(self.motion.late, seconds, strict=True)]
        u = with_past(inputs, time, late)[0]
        x, moved = self._begin(run, u, theta, turned, by, h)
        y, d_y = self._first(x, moved, u, theta, turned, h)
        points, change = np.empty((len(time), len(y))), np.zeros((len(time), len(by), len(y)))
        points[0], change[0] = y, d_y.T
        give_way()
        if len(steps):
            whole = _accumulated(self.motion, chosen, self.substeps, len(steps))
            _, _, ys, d_ys = whole(x, moved, self._inputs(time, inputs, late).T, theta, steps[None])
            points[1:] = np.asarray(ys).T
            if by:
                change[1:] = np.asarray(d_ys).reshape(len(y), len(steps), len(by)).transpose(1, 2, 0)
        if not (np.abs(points).max() < BOUND and np.abs(change).max(initial=0.0) < STEEP):
            raise PredictionError(f"{run.file}: the motion has no bounds; where only its steps are too long, plant(substeps=…) helps")
        return Prediction(points[rows][..., None], np.moveaxis(change[rows], 1, 0)[..., None])

    def _grid(self, run: Run) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Times that are simulated, in s, the inputs there, and which of them are samples: all, where no sample is missing.

        What is 1.5 times as long as usual, or longer, is gone in several steps.

        Raises:
            PredictionError: samples are not equally far apart, but only all samples together tell the inputs between them.
        """
        apart = np.diff(run.time)
        usual = float(np.median(apart)) if len(apart) else 1.0
        if self.between == "band" and np.abs(apart - usual).max(initial=0.0) > 1e-3 * usual:
            raise PredictionError(f'{run.file}: samples are not equally far apart; valid: between = "line" or "hold"')
        if apart.sum() > MOST * usual * run.rows:
            raise PredictionError(
                f"{run.file}: samples are {apart.min():g} to {apart.max():g} s apart; valid: a run of its own for each part"
            )
        rows = np.append(0, np.cumsum(np.maximum(np.round(apart / usual), 1).astype(int)))
        if len(rows) == rows[-1] + 1:
            return run.time, run.inputs, rows
        steps = np.arange(rows[-1] + 1)
        time = np.interp(steps, rows, run.time)
        if self.between == "hold":
            return time, run.inputs[np.searchsorted(rows, steps, side="right") - 1], rows
        return time, _interpolated(time, run.time, run.inputs), rows

    def _steps(self, time: np.ndarray) -> np.ndarray:
        """Time steps, (times - 1,) in s: all the same where they differ by nothing but the file's digits."""
        steps = np.diff(time)
        if not len(steps) or np.ptp(steps) <= 1e-3 * steps.mean():
            return np.full(len(steps), steps.mean() if len(steps) else 0.0) / self.substeps
        return steps / self.substeps

    def _inputs(self, time: np.ndarray, u: np.ndarray, late: Late) -> np.ndarray:
        """Inputs at the ends of all steps between times and at the later one, (times - 1, (substeps + 2) · inputs).

        A dead time of inputs that stay takes their mean over the step, which lies on the straight line between two samples.
        """
        count, gaps = self.substeps, len(u) - 1
        ends = with_past(u, time, late)
        if self.between == "hold":
            fine = np.repeat(ends[:-1, None], count + 1, axis=1)
        else:
            if self.between == "band" and count > 1:
                every = resample_poly(u, count, 1, axis=0, padtype="line")[: gaps * count + 1]
            else:
                every = _interpolated(np.arange(gaps * count + 1) / count, np.arange(len(u)), u)
            every = with_past(every, np.interp(np.arange(gaps * count + 1) / count, np.arange(len(u)), time), late)
            fine = np.stack([every[k : len(every) - count + k : count] for k in range(count + 1)], axis=1)
        return np.concatenate([fine, ends[1:, None]], axis=1).reshape(gaps, -1)

    def _begin(
        self, run: Run, u: np.ndarray, theta: np.ndarray, turned: np.ndarray, by: Sequence[str], h: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """State at the first sample, with these inputs, and its change along the directions."""
        states = self.motion.states
        x, moved = np.array([self.guess[name] for name in states]), np.zeros((len(states), len(by)))
        free = [states.index(name) for name in self.states if name in self.motion.free_states]
        if run.state is None:
            by_theta = self._settle(run, u, x, free, theta, h)
            moved[free] = by_theta @ turned
        else:
            x[free] = run.state[: len(free)]
            for k, name in enumerate(by):
                if name.startswith(START):
                    moved[states.index(name.removeprefix(START)), k] = 1.0
        function = _settling(self.motion, len(by))
        x, moved = (np.asarray(part) for part in function(x, moved, u, theta, turned, h))
        return x.ravel(), moved

    def _settle(self, run: Run, u: np.ndarray, x: np.ndarray, free: list[int], theta: np.ndarray, h: float) -> np.ndarray:
        """Put the free states of x to rest under the first inputs; their change with the parameters, (states, parameters)."""
        if not free:
            return np.zeros((0, len(theta)))
        rates, by_x, by_theta = (np.asarray(part) for part in self.motion.rest(x, u, theta, h))
        size, most = np.abs(x[free]), np.abs(rates)
        for _ in range(NEWTON_STEPS):
            change, _ = _solved(by_x, -rates.ravel())
            x[free] += change
            rates, by_x, by_theta = (np.asarray(part) for part in self.motion.rest(x, u, theta, h))
            size, most = np.fmax(size, np.abs(change)), np.fmax(most, np.abs(rates))
            if (np.abs(change) <= AT_REST * size).all():
                break
        still = (np.abs(rates) <= 1e-6 * np.fmax(most, np.abs(by_x) @ size[:, None])).all()
        if not still or _solved(by_x, -rates.ravel())[1] < len(free):
            what = "comes to rest wherever it is" if still else "does not come to rest"
            raise PredictionError(f'{run.file}: {self.name} {what} under the first inputs; valid: start = "measured" or "free"')
        return -np.linalg.solve(by_x, by_theta)

    def _first(
        self, x: np.ndarray, moved: np.ndarray, u: np.ndarray, theta: np.ndarray, turned: np.ndarray, h: float
    ) -> tuple[np.ndarray, np.ndarray]:
        y, by_x, by_theta = (np.asarray(part) for part in self.motion.measured(x, u, theta, h))
        return y.ravel(), by_x @ moved + by_theta @ turned


def _solved(matrix: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, int]:
    """Least squares with the rank of the matrix, whatever the units of its rows and columns."""
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        return np.full(len(right), np.nan), 0
    rows = np.abs(matrix).max(axis=1, keepdims=True)
    rows[rows == 0] = 1.0
    columns = np.abs(matrix / rows).max(axis=0)
    columns[columns == 0] = 1.0
    found, _, rank, _ = np.linalg.lstsq(matrix / rows / columns, right / rows[:, 0], rcond=1e-12)
    return found / columns, int(rank)


def _interpolated(at: np.ndarray, time: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Columns (times, columns) at other times."""
    return np.array([np.interp(at, time, column) for column in columns.T]).reshape(-1, len(at)).T


@built
@lru_cache(maxsize=256)
def _reduced(motion: Motion, acting: frozenset[str]) -> Motion:
    """`Motion.of`."""
    return motion.of(acting)


@built
@lru_cache(maxsize=64)
def _settling(motion: Motion, directions: int) -> ca.Function:
    """`Motion.begin` with its change along directions."""
    x, u, theta, h = motion.x, motion.u, motion.theta, motion.h
    moved, turned = ca.SX.sym("dx", x.shape[0], directions), ca.SX.sym("dtheta", theta.shape[0], directions)
    at = motion.begin(x, u, theta, h)
    change = _along(at, x, theta, moved, turned)
    return ca.Function("settling", [x, moved, u, theta, turned, h], [at, change])


@built
@lru_cache(maxsize=256)
def _accumulated(motion: Motion, chosen: tuple[int, ...], substeps: int, samples: int) -> ca.Function:
    """All samples of a run in one call."""
    return motion.sampled(chosen, substeps).mapaccum("whole", samples, 2, {"base": 10})

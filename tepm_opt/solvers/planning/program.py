"""The nonlinear program of a plan: splines over time as unknowns, actuators and obstacles as constraints at dense times.

Direct collocation on B-splines (Betts, Practical Methods for Optimal Control, 2010, ch. 4): the actuators' lengths (quintic) and the air's
share of the axial forces, P = p A behind the regulators (cubic), over the part of the duration. Both are flat outputs: tensions λ = P - F,
commands P + lag · P' and rest at both ends need no differential equations. The lag is that of filling where P rises and of exhausting
where it falls; the commands keep their limits if P + filling · P' keeps the upper and P + exhausting · P' the lower.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol

import casadi as ca
import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from tepm_opt.outcome import Ending, Outcome
from tepm_opt.solvers.planning.family import Family

SOFTNESS = 1e-3  # m over which the faces of a box are blended
SCALE = 0.05  # m, of constraints on places
ORDER, AIR_ORDER, HELD = 5, 3, 3  # orders of the splines; coefficients at each end that are held, so that two derivatives are zero
DENSE = 4  # instants at which the constraints are kept, an interval
LONGEST, SHORTEST = 60.0, 0.05  # s


class Obstacle(Protocol):
    """Something that no reference point may be in."""

    def outside(self, point: ca.SX) -> ca.SX:
        """Distance of a point (3,) in G to the obstacle in m or a little less; negative in it."""
        ...


@dataclass(frozen=True)
class Sphere:
    """A ball: centre in G and radius in m."""

    centre: tuple[float, float, float]
    radius: float

    def outside(self, point: ca.SX) -> ca.SX:
        """See `Obstacle`; exact."""
        return ca.sqrt(ca.sumsqr(point - ca.DM(self.centre)) + 1e-12) - self.radius


@dataclass(frozen=True)
class Box:
    """A box along the axes of G between two corners, m."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def outside(self, point: ca.SX) -> ca.SX:
        """See `Obstacle`; a smooth maximum over the faces, up to 1.8 mm less than the farthest."""
        faces = ca.vertcat(ca.DM(self.low) - point, point - ca.DM(self.high)) / SOFTNESS
        most = ca.mmax(faces)
        return SOFTNESS * (most + ca.log(ca.sum1(ca.exp(faces - most)) / 6))


def distance(obstacle: Obstacle) -> ca.Function:
    """`outside` as a function of a point."""
    point = ca.SX.sym("point", 3)
    return ca.Function("outside", [point], [obstacle.outside(point)])


@dataclass(frozen=True)
class Limits:
    """What a program keeps, in N, s and m.

    Attributes:
        air: smallest and largest force of a muscle's pressure.
        tension: smallest and largest.
        max_tension_rate: largest rate of a tension, N/s.
        lags: time constants of filling and exhausting.
        min_stiffness: smallest stiffness eigenvalue in N/m, or None.
        clearance: of the reference points from obstacles.
        max_sway: largest sway of the tip left over where the frequencies are not quite the model's.
        frequencies: at which it is looked for, 1/s; none for a plan that trusts the model.
        frequency_uncertainty: part by which they may be wrong.
    """

    air: tuple[float, float]
    tension: tuple[float, float]
    max_tension_rate: float
    lags: tuple[float, float]
    min_stiffness: float | None
    clearance: float
    max_sway: float
    frequencies: tuple[float, ...]
    frequency_uncertainty: float


@dataclass(frozen=True, eq=False)
class PlanTask:
    """What a program is about.

    Attributes:
        family: of configurations.
        ends: y at start and end, (3,) each.
        air: P at start and end, (modules · 3,) each in N.
        limits: to keep.
        obstacles: for all reference points.
        route: path to keep to, whose ends are then the ends; None for any way.
        duration: in s, or None for the shortest.
        intervals: of the splines.
        max_iterations: most of IPOPT's.
        effort_weight: weight of the effort against time, s per N²/s.
    """

    family: Family
    ends: tuple[np.ndarray, np.ndarray]
    air: tuple[np.ndarray, np.ndarray]
    limits: Limits
    obstacles: tuple[Obstacle, ...]
    route: Route | None
    duration: float | None
    intervals: int
    max_iterations: int
    effort_weight: float


@dataclass(frozen=True, eq=False)
class PlannedMotion:
    """How a program ended.

    Attributes:
        duration: in s.
        place: of y, or of the part of the route, by the part of the duration.
        route: see `PlanTask`.
        air: P by the part of the duration, (modules · 3,) in N.
        outcome: SOLVED or NOT_CONVERGED, with IPOPT's own status.
        iterations, seconds: of IPOPT.
    """

    duration: float
    place: BSpline
    route: Route | None
    air: BSpline
    outcome: Outcome
    iterations: int
    seconds: float

    def __repr__(self) -> str:
        """The outcome and the main numbers, in a line."""
        return f"PlannedMotion({self.outcome.ending}, {self.duration:.4g} s, {self.iterations} iterations)"

    @property
    def solved(self) -> bool:
        """Whether there is a motion."""
        return self.outcome.solved

    def lengths(self, part: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """y, y' and y'' by time, (n, 3) each."""
        first, second = 1 / self.duration, 1 / self.duration**2
        y, v, a = self.place(part), self.place(part, 1) * first, self.place(part, 2) * second
        if self.route is None:
            return y, v, a
        along = [spline(np.clip(y[:, 0], 0.0, 1.0)) for spline in self.route.splines]
        return along[0], along[1] * v, along[2] * v**2 + along[1] * a


class Route:
    """Lengths y along the part of a prescribed path, as a quintic spline through (n, 3) of them at given parts (n,)."""

    def __init__(self, parts: np.ndarray, y: np.ndarray) -> None:
        spline = make_interp_spline(parts, y, k=5)
        self.splines = [spline, spline.derivative(1), spline.derivative(2)]

    def along(self, part: ca.MX) -> list[ca.MX]:
        """y and its first two derivatives by the part, (3, n) each, at parts (1, n)."""
        found = []
        for spline in self.splines:
            coefficients = spline.c[: len(spline.t) - spline.k - 1].ravel().tolist()
            found.append(ca.Function.bspline("route", [spline.t.tolist()], coefficients, [int(spline.k)], 3).map(part.shape[1])(part))
        return found


class Unknowns:
    """Unknowns of a program with their bounds and first guesses, and its constraints."""

    def __init__(self) -> None:
        self.symbols, self.low, self.high, self.guess = [], [], [], []
        self.rows, self.least, self.most = [], [], []

    def add(self, name: str, guess: np.ndarray, low: float = -np.inf, high: float = np.inf) -> ca.MX:
        """Add an unknown; its symbol, in the shape of its first guess.

        Args:
            name: of the symbol.
            guess: first values, in the unknown's unit.
            low, high: bounds of all its entries, in the same unit.
        """
        symbol = ca.MX.sym(name, *guess.shape)
        self.symbols.append(ca.vec(symbol))
        self.guess.append(guess.ravel("F"))
        self.low.append(np.full(guess.size, low))
        self.high.append(np.full(guess.size, high))
        return symbol

    def keep(self, expression: ca.MX, low: float, high: float, scale: float = 1.0) -> None:
        """Add a constraint on all entries of an expression.

        Args:
            expression: of the unknowns, any shape.
            low, high: bounds of all its entries, in its unit.
            scale: typical size in the same unit, by which the solver's numbers are divided.
        """
        self.rows.append(ca.vec(expression) / scale)
        self.least.append(np.full(expression.numel(), low / scale))
        self.most.append(np.full(expression.numel(), high / scale))

    def minimise(self, objective: ca.MX, iterations: int) -> tuple[np.ndarray, dict]:
        """Values of all unknowns and IPOPT's statistics."""
        problem = {"x": ca.vertcat(*self.symbols), "f": objective, "g": ca.vertcat(*self.rows)}
        quiet = {"print_level": 0, "sb": "yes", "max_iter": iterations, "tol": 1e-6, "mu_strategy": "adaptive"}
        solver = ca.nlpsol("plan", "ipopt", problem, {"ipopt": quiet, "print_time": False, "error_on_fail": False})
        join = np.concatenate
        result = solver(x0=join(self.guess), lbx=join(self.low), ubx=join(self.high), lbg=join(self.least), ubg=join(self.most))
        return np.asarray(result["x"]).ravel(), solver.stats()


def collocation(intervals: int, order: int, at: np.ndarray) -> list[np.ndarray]:
    """Values of all basis splines and of their first two derivatives, (instants, coefficients) each."""
    spline = BSpline(_knots(intervals, order), np.eye(intervals + order), order)
    return [spline(at, nu=k) for k in range(3)]


def _knots(intervals: int, order: int) -> np.ndarray:
    return np.concatenate([np.zeros(order), np.linspace(0.0, 1.0, intervals + 1), np.ones(order)])


def _between(first: np.ndarray, last: np.ndarray, count: int) -> np.ndarray:
    """First guess of the free coefficients of a spline that holds its ends, (count, columns)."""
    part = np.linspace(0.0, 1.0, count + 2)[1:-1, None]
    return (1 - part) * first + part * last


def _held(first: np.ndarray, free: ca.MX | np.ndarray, last: np.ndarray) -> ca.MX | np.ndarray:
    """All coefficients of a spline that rests at both ends."""
    before, after = np.tile(first, (HELD, 1)), np.tile(last, (HELD, 1))
    return np.vstack([before, free, after]) if isinstance(free, np.ndarray) else ca.vertcat(before, free, after)


def solve(task: PlanTask, bulge: np.ndarray | None = None, guess: float = 1.0) -> PlannedMotion:
    """The fastest motion from rest to rest or, with a duration, the one of least effort.

    Args:
        task: what about.
        bulge: of the first guess to one side, (3,) in y.
        guess: first guess of the duration in s.
    """
    began = time.perf_counter()
    family, limits, route, intervals = task.family, task.limits, task.route, task.intervals
    count, at = len(task.air[0]), np.linspace(0.0, 1.0, DENSE * intervals + 1)
    instants = len(at)
    ends = task.ends if route is None else (np.zeros(1), np.ones(1))
    guess = task.duration or guess
    bounds = (SHORTEST, LONGEST) if task.duration is None else (task.duration, task.duration)
    free_guess = _between(*ends, intervals + ORDER - 2 * HELD)
    if bulge is not None:
        part = np.linspace(0.0, 1.0, len(free_guess))[:, None]
        free_guess = free_guess + 4 * part * (1 - part) * bulge
    air_guess = _between(*task.air, intervals + AIR_ORDER - 2 * HELD)
    bound = 1.0 if route is None else np.inf

    program = Unknowns()
    T = program.add("T", np.array([[guess]]), *bounds)
    free = program.add("c", free_guess, -bound, bound)
    free_air = program.add("P", air_guess)
    bases = [ca.sparsify(ca.DM(basis)) for basis in collocation(intervals, ORDER, at)]
    air_bases = [ca.sparsify(ca.DM(basis)) for basis in collocation(intervals, AIR_ORDER, at)]
    shape = _held(ends[0], free, ends[1])
    splines = [ca.mtimes(basis, shape).T for basis in bases]
    if route is not None:
        along, (speed, change) = route.along(splines[0]), (ca.repmat(spline, 3, 1) for spline in splines[1:])
        splines = [along[0], along[1] * speed, along[2] * speed**2 + along[1] * change]
        program.keep(ca.diff(shape), 0.0, np.inf)
    begin = ca.Function("begin", [T, free], splines)(guess, free_guess)
    # lengths, tensions and sums at the instants are unknowns of their own, which makes the derivatives sparse: ten times faster
    y, v, a = (program.add("y", np.asarray(value) / guess**power) for power, value in enumerate(begin))
    tension = program.add("tension", np.full((count, instants), sum(limits.tension) / 2), *limits.tension)
    for power, (value, spline) in enumerate(zip((y, v, a), splines, strict=True)):
        program.keep(value * T**power - spline, 0.0, 0.0)

    P, dP, ddP = (ca.mtimes(basis, _held(task.air[0], free_air, task.air[1])).T for basis in air_bases)
    rate, step = dP / T, T / (instants - 1)
    wind = ca.diff(tension, 1, 1) / step
    program.keep(P - family.moving.map(instants)(y, v, a) - tension, 0.0, 0.0)
    program.keep(wind, -limits.max_tension_rate, limits.max_tension_rate, 5.0)
    filling, exhausting = limits.lags
    program.keep(P + filling * rate, -np.inf, limits.air[1])
    program.keep(P + exhausting * rate, limits.air[0], np.inf)
    program.keep(P, *limits.air)
    if limits.min_stiffness is not None:
        program.keep(family.stability.map(instants)(y), limits.min_stiffness, np.inf, 0.1)
    if task.obstacles:
        points = ca.reshape(family.points.map(instants)(y), 3, -1)
        for obstacle in task.obstacles:
            program.keep(distance(obstacle).map(points.shape[1])(points), limits.clearance, np.inf, SCALE)
    _keep_still(program, task, T, a, at)

    command = rate + (filling + exhausting) / 2 * ddP / T**2
    effort = step * (ca.sumsqr(wind) + ca.sumsqr(command))
    effort += 1e-3 * step * ca.sumsqr(tension - sum(limits.tension) / 2)  # where nothing else decides, stay in the middle
    objective = T + task.effort_weight * effort if task.duration is None else 0.01 * effort
    values, stats = program.minimise(objective, task.max_iterations)
    parts = np.split(values, np.cumsum([1, free_guess.size, air_guess.size]))
    place = _held(ends[0], parts[1].reshape(free_guess.shape, order="F"), ends[1])
    air = _held(task.air[0], parts[2].reshape(air_guess.shape, order="F"), task.air[1])
    outcome = Outcome(Ending.SOLVED if stats["success"] else Ending.NOT_CONVERGED, str(stats["return_status"]))
    return PlannedMotion(
        float(values[0]), BSpline(_knots(intervals, ORDER), place, ORDER), route, BSpline(_knots(intervals, AIR_ORDER), air, AIR_ORDER),
        outcome, int(stats["iter_count"]), time.perf_counter() - began,
    )  # fmt: skip


def _keep_still(program: Unknowns, task: PlanTask, T: ca.MX, a: ca.MX, at: np.ndarray) -> None:
    """Bounds on the sway that is left where a frequency differs from the model's.

    An arm that sways at ω (1 + ε) follows the planned forces with an error that is driven by 2 ε times the planned acceleration; what is
    left of it at the end is the acceleration's Fourier integral (input shaping: Singer and Seering, ASME JDSMC 112, 1990). The integral is
    summed up instant by instant, as one long sum would cost the derivatives' sparsity.
    """
    limits = task.limits
    tip = np.array(task.family.points.jacobian()(0, 0))[-3:-1]  # across, by y in the middle
    weights = np.full((2, len(at)), 1 / (len(at) - 1))
    weights[:, [0, -1]] /= 2
    for frequency in limits.frequencies:
        across = ca.mtimes(ca.DM(tip), a) * ca.DM(weights) * T
        phase = ca.repmat(frequency * T * ca.DM(1 - at).T, 2, 1)
        sums = program.add("sums", np.zeros((4, len(at))))
        program.keep(ca.diff(ca.horzcat(ca.DM.zeros(4), sums), 1, 1) - ca.vertcat(across * ca.cos(phase), across * ca.sin(phase)), 0.0, 0.0)
        program.keep(ca.sumsqr(sums[:, -1]) * (2 * limits.frequency_uncertainty / frequency / limits.max_sway) ** 2, -np.inf, 1.0)

"""The program of a plan about a motion: splines over time as unknowns, actuators and obstacles as rows at dense times, with derivatives.

Direct collocation on B-splines (Betts, Practical Methods for Optimal Control, 2010, ch. 4): the actuators' lengths (quintic) and the air's
share of the axial forces, P = p A behind the regulators (cubic), over the part of the duration. Both are flat outputs: tensions λ = P - F,
commands P + lag · P' and rest at both ends need no differential equations. The lag is that of filling where P rises and of exhausting
where it falls; the commands keep their limits, and with them P, if P + filling · P' keeps the upper and P + exhausting · P' the lower.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.interpolate import BSpline

from tepm_opt.solvers.planning.program import PlanTask, distance

SCALE = 0.005  # m, of rows on places
ORDER, AIR_ORDER = 5, 3  # of the splines
HELD, AIR_HELD = 3, 2  # coefficients at each end that are held, so that two derivatives of the lengths are zero, and one of the air
LEAST, MOST = 2, 4  # instants an interval at which the rows are kept
SIDES = 8  # of the polygon that stands for a circle


@dataclass(frozen=True, eq=False)
class Rows:
    """The program about some unknowns x; derivatives have a column for each.

    Attributes:
        values, slopes, low, high: of what is bounded, (rows,) and (rows, unknowns), in units in which 1 is much.
        residuals, residual_slopes: whose sum of squares is the effort, in N/√s.
    """

    values: np.ndarray
    slopes: np.ndarray
    low: np.ndarray
    high: np.ndarray
    residuals: np.ndarray
    residual_slopes: np.ndarray

    @property
    def beyond(self) -> np.ndarray:
        """Excess of the rows over their bounds, (rows,)."""
        return np.maximum(np.maximum(self.low - self.values, self.values - self.high), 0.0)


class Program:
    """A task as rows of unknowns x: the logarithm of the duration, coefficients of the place (free, columns) and the air (free, forces)."""

    def __init__(self, task: PlanTask, instants: float = 0) -> None:
        """A program.

        Args:
            task: what about.
            instants: at which the rows are kept, as far as there are no less than `LEAST` and no more than `MOST` an interval.
        """
        self.task, route, intervals = task, task.route, task.intervals
        self.at = at = np.linspace(0.0, 1.0, int(np.clip(instants, LEAST * intervals, MOST * intervals)) + 1)
        self.air_intervals = (intervals + 1) // 2
        self.ends = task.ends if route is None else (np.zeros(1), np.ones(1))
        self.place, self.fixed_place = _bases(intervals, ORDER, HELD, at, *self.ends)
        self.air, self.fixed_air = _bases(self.air_intervals, AIR_ORDER, AIR_HELD, at, *task.air)
        self.columns, self.forces = len(self.ends[0]), len(task.air[0])
        self.places = self.place[0].shape[1] * self.columns
        self.airs = self.air[0].shape[1] * self.forces
        self.unknowns = 1 + self.places + self.airs
        self._outside = [_differentiate_distance(distance(obstacle)) for obstacle in task.obstacles]
        tip = task.family.points.slopes(np.zeros((1, 3)))[0, -3:-1]  # across, by y in the middle
        self._across = tip

    def guess(self, duration: float, bulge: np.ndarray | None = None) -> np.ndarray:
        """Straight from end to end, or with a bulge (3,) in y to one side, as x."""
        part, late = (_smooth(basis[0].shape[1]) for basis in (self.place, self.air))
        place = (1 - part) * self.ends[0] + part * self.ends[1]
        if bulge is not None:
            place = place + 4 * part * (1 - part) * bulge
        air = (1 - late) * self.task.air[0] + late * self.task.air[1]
        return np.concatenate([[np.log(duration)], place.ravel(), air.ravel()])

    def splines(self, x: np.ndarray) -> tuple[float, BSpline, BSpline]:
        """Duration, place and air by the part of the duration."""
        place = x[1 : 1 + self.places].reshape(-1, self.columns)
        air = x[1 + self.places :].reshape(-1, self.forces)
        return (
            float(np.exp(x[0])),
            BSpline(_knots(self.task.intervals, ORDER), _join_ends(self.ends[0], place, self.ends[1], HELD), ORDER),
            BSpline(_knots(self.air_intervals, AIR_ORDER), _join_ends(self.task.air[0], air, self.task.air[1], AIR_HELD), AIR_ORDER),
        )

    def linearise(self, x: np.ndarray) -> Rows:
        """Linearise the program: values and derivatives at x."""
        limits, T, n = self.task.limits, float(np.exp(x[0])), len(self.at)
        step = T / (n - 1)
        motion, by = self._motion(x, T)
        needed, slopes = self.task.family.compute_motion_forces(motion[:, :3], motion[:, 3:6], motion[:, 6:])
        of_forces = np.einsum("nfj,njx->nfx", slopes, by)
        air, of_air = self._air(x)
        tension, of_tension = air[0] - needed, -of_forces
        of_tension += of_air[0]
        wind, of_wind = np.diff(tension, axis=0) / step, np.diff(of_tension, axis=0) / step
        of_wind[..., 0] -= wind
        rate, of_rate = air[1] / T, of_air[1] / T
        of_rate[..., 0] -= rate
        filling, exhausting = limits.lags
        infinite = np.inf
        rows: list[tuple[np.ndarray, np.ndarray, float, float, float]] = [
            (tension, of_tension, *limits.tension, 1.0),
            (wind, of_wind, -limits.max_tension_rate, limits.max_tension_rate, 5.0),
            (air[0] + filling * rate, of_air[0] + filling * of_rate, -infinite, limits.air[1], 5.0),
            (air[0] + exhausting * rate, of_air[0] + exhausting * of_rate, limits.air[0], infinite, 5.0),
        ]
        if self.task.route is not None:
            rows.append(self._onward(x))
        margin = self.task.family.stability
        if limits.min_stiffness is not None and margin is not None:
            y = motion[:, :3]
            rows.append((margin(y), np.einsum("nfj,njx->nfx", margin.slopes(y), by[:, :3]), limits.min_stiffness, infinite, 0.1))
        rows += self._clear(motion[:, :3], by[:, :3])
        rows += self._still(T, motion[:, 6:], by[:, 6:])
        quick = (of_air[2] / T**2, air[2] / T**2)
        quick[0][..., 0] -= 2 * quick[1]
        lag = (filling + exhausting) / 2
        root, middle = np.sqrt(step), np.sqrt(1e-3 * step)  # where nothing else decides, stay in the middle
        residuals = [
            (root * wind, root * of_wind),
            (root * (rate + lag * quick[1]), root * (of_rate + lag * quick[0])),
            (middle * (tension - sum(limits.tension) / 2), middle * of_tension),
        ]
        for value, of_value in residuals:
            of_value[..., 0] += value / 2
        flat = [
            (value.ravel() / scale, of.reshape(value.size, -1) / scale, low / scale, high / scale) for value, of, low, high, scale in rows
        ]
        join = np.concatenate
        return Rows(
            values=join([value for value, _, _, _ in flat]),
            slopes=join([of for _, of, _, _ in flat]),
            low=join([np.full(len(value), low) for value, _, low, _ in flat]),
            high=join([np.full(len(value), high) for value, _, _, high in flat]),
            residuals=join([value.ravel() for value, _ in residuals]),
            residual_slopes=join([of.reshape(value.size, -1) for value, of in residuals]),
        )

    def _motion(self, x: np.ndarray, T: float) -> tuple[np.ndarray, np.ndarray]:
        """y, y', y'' by time (instants, 9), and their derivatives (instants, 9, unknowns)."""
        n, inner = len(self.at), slice(1, 1 + self.places)
        place = x[inner].reshape(-1, self.columns)
        values = [basis @ place + fixed for basis, fixed in zip(self.place, self.fixed_place, strict=True)]
        by = np.zeros((n, 9, self.unknowns))
        if self.task.route is None:
            for power, basis in enumerate(self.place):
                for k in range(3):
                    by[:, 3 * power + k, 1 + k : 1 + self.places : 3] = basis / T**power
            motion = np.hstack([value / T**power for power, value in enumerate(values)])
        else:
            (part, speed, change), (B, dB, ddB) = values, self.place
            y, first, second, third = (one[:, :, None] for one in self.task.route.evaluate(part[:, 0]))
            B, dB, ddB = B[:, None], dB[:, None], ddB[:, None]
            speed, change = speed[:, :, None], change[:, :, None]
            by[:, :3, inner] = first * B
            by[:, 3:6, inner] = (second * speed * B + first * dB) / T
            by[:, 6:, inner] = (third * speed**2 * B + 2 * second * speed * dB + second * change * B + first * ddB) / T**2
            motion = np.concatenate([y, first * speed / T, (second * speed**2 + first * change) / T**2], axis=1)[:, :, 0]
        by[:, 3:6, 0], by[:, 6:, 0] = -motion[:, 3:6], -2 * motion[:, 6:]
        return motion, by

    def _air(self, x: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """P and its derivatives by the part (instants, forces), and theirs by the unknowns."""
        free, found, slopes = x[1 + self.places :].reshape(-1, self.forces), [], []
        for basis, fixed in zip(self.air, self.fixed_air, strict=True):
            found.append(basis @ free + fixed)
            by = np.zeros((len(self.at), self.forces, self.unknowns))
            for k in range(self.forces):
                by[:, k, 1 + self.places + k :: self.forces] = basis
            slopes.append(by)
        return found, slopes

    def _onward(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, float, float]:
        """A path is not gone back."""
        place = x[1 : 1 + self.places]
        by = np.zeros((len(place) + 1, self.unknowns))
        by[np.arange(len(place)), 1 + np.arange(len(place))] = 1.0
        by[1 + np.arange(len(place)), 1 + np.arange(len(place))] = -1.0
        return np.diff(np.concatenate([[0.0], place, [1.0]])), by, 0.0, np.inf, 0.1

    def _clear(self, y: np.ndarray, by: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, float, float, float]]:
        """All reference points are outside the obstacles."""
        if not self._outside:
            return []
        points = self.task.family.points
        where = points(y).reshape(len(y), -1, 3)
        of = np.einsum("nfj,njx->nfx", points.slopes(y), by).reshape(*where.shape, -1)
        rows = []
        for outside in self._outside:
            away, slopes = (np.asarray(part) for part in outside.map(where.size // 3)(where.reshape(-1, 3).T))
            of_away = np.einsum("npk,npkx->npx", slopes.T.reshape(where.shape), of)
            rows.append((away.reshape(where.shape[:2]), of_away, self.task.limits.clearance, np.inf, SCALE))
        return rows

    def _still(self, T: float, a: np.ndarray, by: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, float, float, float]]:
        """Bounds on the sway that is left where a frequency differs from the model's.

        An arm that sways at ω (1 + ε) follows the planned forces with an error that is driven by 2 ε times the planned acceleration; what
        is left of it at the end is the acceleration's Fourier integral (input shaping: Singer and Seering, ASME JDSMC 112, 1990), here in
        two directions across, each within a polygon about its circle.
        """
        limits, rows = self.task.limits, []
        weights = np.full(len(self.at), 1 / (len(self.at) - 1))
        weights[[0, -1]] /= 2
        across, of_across = a @ self._across.T, np.einsum("kj,njx->nkx", self._across, by)
        angles = np.pi * np.arange(SIDES // 2) / (SIDES // 2)
        for frequency in limits.frequencies:
            left = frequency * T * (1 - self.at)
            size = 2 * limits.frequency_uncertainty / frequency / limits.max_sway * T * np.sqrt(2.0)
            for angle in angles:
                wave = size * weights * np.cos(left - angle)
                turned = -size * weights * np.sin(left - angle) * left + wave  # by the logarithm of the duration
                of = np.einsum("n,nkx->kx", wave, of_across)
                of[:, 0] += turned @ across
                rows.append((wave @ across, of, -1.0, 1.0, 0.1))
        return rows


def _bases(
    intervals: int, order: int, held: int, at: np.ndarray, first: np.ndarray, last: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Values and two derivatives of a spline that rests at both ends, by its free coefficients, and what the held ones make.

    Args:
        intervals, order: of the spline.
        held: coefficients at each end.
        at: instants, (n,).
        first, last: values of the spline at its ends, (columns,).
    """
    spline = BSpline(_knots(intervals, order), np.eye(intervals + order), order)
    all_of = [spline(at, nu=k) for k in range(3)]
    fixed = [basis[:, :held].sum(axis=1)[:, None] * first + basis[:, -held:].sum(axis=1)[:, None] * last for basis in all_of]
    return [basis[:, held:-held] for basis in all_of], fixed


def _knots(intervals: int, order: int) -> np.ndarray:
    return np.concatenate([np.zeros(order), np.linspace(0.0, 1.0, intervals + 1), np.ones(order)])


def _join_ends(first: np.ndarray, free: np.ndarray, last: np.ndarray, held: int) -> np.ndarray:
    """Join the free coefficients of a spline with those that let it rest at both ends."""
    return np.vstack([np.tile(first, (held, 1)), free, np.tile(last, (held, 1))])


def _smooth(count: int) -> np.ndarray:
    """0 … 1 with rest at both ends, as free coefficients of a spline, (count, 1)."""
    part = np.linspace(0.0, 1.0, count + 2)[1:-1, None]
    return part**3 * (10 - 15 * part + 6 * part**2)


def _differentiate_distance(outside: ca.Function) -> ca.Function:
    """A distance with its derivatives by the point."""
    point = ca.SX.sym("point", 3)
    away = outside(point)
    return ca.Function("sloped", [point], [away, ca.gradient(away, point)])

"""Task and result of a program of planning: obstacles, limits, paths, motions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import casadi as ca
import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from tepm_opt.outcome import Outcome
from tepm_opt.solvers.planning.family import Family

SOFTNESS = 1e-3  # m over which the faces of a box are blended


class Obstacle(Protocol):
    """Something that no reference point may be in."""

    def distance_to(self, point: ca.SX) -> ca.SX:
        """Distance of a point (3,) in G to the obstacle in m or a little less; negative in it."""
        ...


@dataclass(frozen=True)
class Sphere:
    """A ball: centre in G and radius in m."""

    centre: tuple[float, float, float]
    radius: float

    def distance_to(self, point: ca.SX) -> ca.SX:
        """See `Obstacle`; exact."""
        return ca.sqrt(ca.sumsqr(point - ca.DM(self.centre)) + 1e-12) - self.radius


@dataclass(frozen=True)
class Box:
    """A box along the axes of G between two corners, m."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def distance_to(self, point: ca.SX) -> ca.SX:
        """See `Obstacle`; a smooth maximum over the faces, up to 1.8 mm less than the farthest."""
        faces = ca.vertcat(ca.DM(self.low) - point, point - ca.DM(self.high)) / SOFTNESS
        most = ca.mmax(faces)
        return SOFTNESS * (most + ca.log(ca.sum1(ca.exp(faces - most)) / 6))


@dataclass(frozen=True)
class TurnedBox:
    """A box along axes of its own.

    Attributes:
        centre: in G in m.
        size: along its axes in m.
        rotation: matrix from its axes to those of G, by rows.
    """

    centre: tuple[float, float, float]
    size: tuple[float, float, float]
    rotation: tuple[tuple[float, ...], ...]

    def distance_to(self, point: ca.SX) -> ca.SX:
        """See `Obstacle`; as for `Box`."""
        x, y, z = (side / 2 for side in self.size)
        return Box((-x, -y, -z), (x, y, z)).distance_to(ca.DM(self.rotation).T @ (point - ca.DM(self.centre)))


@dataclass(frozen=True)
class HalfSpace:
    """All that is behind a plane: a point of it in G in m, and the normal, 1 long, towards where the robot may be."""

    point: tuple[float, float, float]
    normal: tuple[float, float, float]

    def distance_to(self, point: ca.SX) -> ca.SX:
        """See `Obstacle`; exact."""
        return ca.dot(ca.DM(self.normal), point - ca.DM(self.point))


def distance(obstacle: Obstacle) -> ca.Function:
    """`distance_to` as a function of a point."""
    point = ca.SX.sym("point", 3)
    return ca.Function("outside", [point], [obstacle.distance_to(point)])


@dataclass(frozen=True)
class Limits:
    """Limits that a program keeps, in N, s and m.

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
    """Task of a program: ends, limits, obstacles and route.

    Attributes:
        family: of configurations.
        ends: y at start and end, (3,) each.
        air: P at start and end, (modules · 3,) each in N.
        limits: to keep.
        obstacles: for all reference points.
        route: path to keep to, whose ends are then the ends; None for any way.
        duration: in s, or None for the shortest.
        intervals: of the splines.
        max_iterations: most quadratic programs.
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
    """Motion that a program found, or the reason why there is none.

    Attributes:
        duration: in s.
        place: of y, or of the part of the route, by the part of the duration.
        route: see `PlanTask`.
        air: P by the part of the duration, (modules · 3,) in N.
        outcome: SOLVED or NOT_CONVERGED, and how.
        iterations, seconds: quadratic programs, and what they took.
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
        along = self.route.evaluate(y[:, 0])
        return along[0], along[1] * v, along[2] * v**2 + along[1] * a


class Route:
    """Lengths y along the part of a prescribed path, as a quintic spline through (n, 3) of them at given parts (n,)."""

    def __init__(self, parts: np.ndarray, y: np.ndarray) -> None:
        spline = make_interp_spline(parts, y, k=5)
        self.splines = [spline.derivative(order) if order else spline for order in range(4)]

    def evaluate(self, part: np.ndarray) -> list[np.ndarray]:
        """Evaluate y and its first three derivatives by the part, (n, 3) each, at parts (n,)."""
        return [spline(np.clip(part, 0.0, 1.0)) for spline in self.splines]

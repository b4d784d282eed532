"""Places of a robot's network at which missing physics may act, each with the variable that its law may depend on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.linalg import block_diag

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.symbolic.curves import Lags, Plays, Powers, Shape, Spline
from tepm_opt.discrepancy.symbolic.settings import DEFAULT, SymbolicSettings
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.layout import Layout

Kind = Literal["axial", "force", "measurement"]
ALL = "all"
VARIABLE_UNITS = {
    "pressure": "Pa", "neighbours": "Pa", "supply": "Pa", "tension": "N", "length": "m", "rate": "m/s", "time": "s", "position": "m",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Course:
    """A simulated run, at the samples at which derivatives are taken.

    Attributes:
        model: of the simulation.
        run: inputs and times, at these samples.
        points: reference points in G, (samples, points, 3) in m.
        lengths: of the actuators, (samples, actuators) in m.
        static: whether samples are equilibria, so that nothing has a rate.
    """

    model: CompiledModel
    run: Run
    points: np.ndarray
    lengths: np.ndarray
    static: bool = False
    known: dict[str, np.ndarray] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Course({self.run.file}, {self.run.rows} samples)"

    @property
    def time(self) -> np.ndarray:
        """Times of the samples in s; their numbers where they have none."""
        return np.arange(self.run.rows, dtype=float) if self.static else self.run.time

    def rate(self, values: np.ndarray) -> np.ndarray:
        """Rate of values at the samples."""
        return np.zeros_like(values) if self.static else np.gradient(values, self.time, axis=0)

    def values_of(self, variable: str) -> np.ndarray:
        """A variable's values: of every actuator, (samples, actuators), or of every point, (samples, points, 3)."""
        if variable not in self.known:
            self.known[variable] = self._compute(variable)
        return self.known[variable]

    def _compute(self, variable: str) -> np.ndarray:
        layout, half = self.model.layout, self.model.layout.inputs // 2
        pressure, tension = self.run.inputs[:, :half], self.run.inputs[:, half:]
        if variable == "neighbours":
            modules = pressure.reshape(len(pressure), layout.modules, layout.actuators)
            return ((modules.sum(axis=2, keepdims=True) - modules) / max(layout.actuators - 1, 1)).reshape(pressure.shape)
        found = {
            "pressure": pressure,
            "tension": tension,
            "length": self.lengths,
            "supply": np.repeat(pressure.mean(axis=1, keepdims=True), half, axis=1),
            "time": np.repeat((self.run.began + self.time - self.time[0])[:, None], half, axis=1),
            "position": self.points,
        }
        if variable in found:
            return found[variable]
        return self.rate(self.lengths if variable == "rate" else self.points)


@dataclass(frozen=True)
class Place:
    """Place at which a law acts, and the variable that it depends on.

    Attributes:
        kind: "axial": a force that pushes the ends of actuators apart; "force": on a reference point; "measurement": of points.
        target: actuator or point by name, or "all" of them alike.
        variable: that the law depends on: "pressure", "tension", "length", "rate", "supply" (mean of all pressures), "neighbours" (mean
            pressure of the module's others), "time"; "position", "speed".
        shape: functions it may be.
        memory: "", "late" or "remembered".
        times: variable that the function is multiplied by, or "".
        most: largest value of the variable it is multiplied by, at which its coefficients hold; of the speed where it depends on that.
    """

    kind: Kind
    target: str
    variable: str
    shape: Shape = field(compare=False)
    memory: str = ""
    times: str = ""
    most: float = field(default=1.0, compare=False)

    @property
    def label(self) -> str:
        """The place in a word: "axial[13](pressure)"."""
        return f"{self.kind}[{self.target}]({self.of})"

    @property
    def of(self) -> str:
        """The variable in words: "pressure remembered"."""
        return " ".join(part for part in (self.variable, self.memory, f"and {self.times}" if self.times else "") if part)

    @property
    def unit(self) -> str:
        """SI unit of the law."""
        return "m" if self.kind == "measurement" else "N"

    @property
    def slow(self) -> float:
        """Speed in m/s below which a dry force against the motion turns round gradually: a twentieth of the largest."""
        return 0.05 * self.most

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return len(self.penalty)

    @property
    def penalty(self) -> np.ndarray:
        """Precision of the prior of the coefficients, up to its strength."""
        along = 3 if self.kind != "axial" and self.variable in ("position", "time") else 1
        if self.kind == "measurement" and self.variable == "speed":
            return np.eye(2)
        if self.kind == "force" and self.variable == "speed":
            return np.eye(3)
        return np.asarray(block_diag(*[self.shape.penalty] * along))

    def targets(self, layout: Layout) -> list[int]:
        """Numbers of the actuators or points."""
        names = layout.actuator_names if self.kind == "axial" else layout.point_names
        return list(range(len(names))) if self.target == ALL else [names.index(self.target)]

    def columns(self, course: Course) -> np.ndarray:
        """Contribution of each coefficient: (samples, size, actuators) in N, or (samples, size, points, 3) in N or m."""
        values, layout = course.values_of(self.variable), course.model.layout
        targets = self.targets(layout)
        if self.kind == "axial":
            found = np.zeros((len(values), self.size, values.shape[1]))
            shaped = self.shape.columns(values[:, targets], course.time)
            if self.times:
                shaped = shaped * (course.values_of(self.times)[:, targets] / self.most)[..., None]
            found[:, :, targets] = shaped.transpose(0, 2, 1)
            return found
        found = np.zeros((len(course.points), self.size, layout.points, 3))
        for k in targets:
            found[:, :, k] = self._by_speed(course, k) if self.variable == "speed" else self._along_axes(course, k)
        return found

    def _by_speed(self, course: Course, point: int) -> np.ndarray:
        """Contributions at one point of a law of its speed, (samples, size, 3)."""
        velocity = course.rate(course.points[:, point])
        speed = np.linalg.norm(velocity, axis=1, keepdims=True)
        most = self.most
        if self.kind == "measurement":
            return np.stack([velocity, speed * velocity / most], axis=1)
        return -np.stack([velocity / np.hypot(speed, self.slow), velocity / most, speed * velocity / most**2], axis=1)

    def _along_axes(self, course: Course, point: int) -> np.ndarray:
        """Contributions at one point, (samples, size, 3): coefficients of x, then y, then z; splines each by its own coordinate."""
        values = course.values_of("time")[:, 0] if self.variable == "time" else course.points[:, point]
        shaped, size = self.shape.columns(values, course.time), self.shape.size
        found = np.zeros((len(shaped), self.size, 3))
        for axis in range(3):
            found[:, axis * size : (axis + 1) * size, axis] = shaped if shaped.ndim == 2 else shaped[:, axis]
        return found


def find_places(courses: Sequence[Course], settings: SymbolicSettings = DEFAULT) -> list[Place]:
    """All places of a robot, with shapes over the values that the runs visit."""
    layout, static = courses[0].model.layout, all(course.static for course in courses)
    every, points = layout.actuator_names, np.concatenate([course.points for course in courses])

    def visit(variable: str) -> np.ndarray:
        return np.concatenate([course.values_of(variable).reshape(course.run.rows, -1) for course in courses])

    found: list[Place] = []
    for variable, pieces, alone, knots in (
        ("pressure", 4, True, Spline.from_zero),
        ("tension", 3, True, Spline.from_zero),
        ("length", 3, True, Spline.from_values),
        ("rate", 3, True, Spline.from_values),
        ("neighbours", 2, False, Spline.from_values),
        ("time", 3, False, Spline.from_values),
    ):
        values = visit(variable)
        if np.ptp(values) > 0:
            shape = knots(values.ravel(), pieces)
            found += [Place("axial", target, variable, shape) for target in (ALL, *(every if alone else ()))]
    for variable in ("supply", "length"):
        if np.ptp(visit(variable)) > 0:
            shape, most = Spline.from_values(visit(variable).ravel(), 2), float(visit("pressure").max())
            found.append(Place("axial", ALL, variable, shape, times="pressure", most=most))
    for variable, alone in (("pressure", True), ("tension", False), ("length", False)) if not static else ():
        reach = float(np.ptp(visit(variable)))
        if reach > 0:
            lags, plays = Lags(settings.lag_times, reach), Plays(tuple(width * reach for width in settings.play_widths), reach)
            for shape, memory in ((lags, "late"), (plays, "remembered")):
                found += [Place("axial", target, variable, shape, memory) for target in (ALL, *(every if alone else ()))]
    found.append(Place("force", layout.point_names[-1], "position", Spline.from_values(points[:, -1].ravel(), 2)))
    fastest = [max(float(np.linalg.norm(c.rate(c.points[:, k]), axis=1).max()) for c in courses) or 1.0 for k in range(layout.points)]
    drags, by_point = Powers((), (), 0), list(zip(layout.point_names, fastest, strict=True))
    if not static:
        found += [Place("force", point, "speed", drags, most=most) for point, most in ((ALL, fastest[-1]), *by_point)]
    found += [Place("measurement", ALL, "position", Powers.from_values(points.reshape(-1, 3), 3))]
    found += [Place("measurement", name, "position", Powers.from_values(points[:, k], 1)) for k, name in enumerate(layout.point_names)]
    if not static:
        session = Spline.from_values(visit("time").ravel(), 3)
        for target, most in ((ALL, fastest[-1]), *by_point):
            found += [Place("measurement", target, "time", session), Place("measurement", target, "speed", drags, most=most)]
    return found

"""Where missing physics may act: the places of a robot's network, each with the variable that its law may depend on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.symbolic.curves import Lags, Plays, Powers, Shape, Spline, straight
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.layout import Layout

Kind = Literal["axial", "force", "measurement"]
ALL = "all"
UNITS = {"axial": "N", "force": "N", "measurement": "m"}
SLOW = 0.05  # part of the largest speed over which a force against the motion turns round
LAGS = (0.05, 0.2, 0.8, 4.0)  # s
RADII = (0.01, 0.03, 0.08, 0.2)  # of the visited range


@dataclass(frozen=True, eq=False)
class Course:
    """A run as a model does it, at the samples at which derivatives are taken.

    Attributes:
        model: that did it.
        run: what was done, at these samples.
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

    def of(self, variable: str, layout: Layout) -> np.ndarray:
        """A variable's values: of every actuator, (samples, actuators), or of every point, (samples, points, 3)."""
        if variable not in self.known:
            self.known[variable] = self._of(variable, layout)
        return self.known[variable]

    def _of(self, variable: str, layout: Layout) -> np.ndarray:
        half = layout.inputs // 2
        pressure, tension = self.run.inputs[:, :half], self.run.inputs[:, half:]
        if variable == "neighbours":
            modules = pressure.reshape(len(pressure), layout.modules, layout.actuators)
            return ((modules.sum(axis=2, keepdims=True) - modules) / max(layout.actuators - 1, 1)).reshape(pressure.shape)
        found: Mapping[str, np.ndarray] = {
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
    """Where a law acts and what it depends on.

    Attributes:
        kind: "axial": a force that pushes the ends of actuators apart; "force": on a reference point; "measurement": of points.
        target: actuator or point by name, or "all" of them alike.
        variable: what the law depends on: "pressure", "tension", "length", "rate", "supply" (mean of all pressures), "neighbours" (mean
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
        """What the law depends on, in words: "pressure remembered"."""
        return " ".join(part for part in (self.variable, self.memory, f"and {self.times}" if self.times else "") if part)

    @property
    def unit(self) -> str:
        """SI unit of the law."""
        return UNITS[self.kind]

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
        return straight([self.shape.penalty] * along)

    def targets(self, layout: Layout) -> list[int]:
        """Numbers of the actuators or points."""
        names = layout.actuator_names if self.kind == "axial" else layout.point_names
        return list(range(len(names))) if self.target == ALL else [names.index(self.target)]

    def columns(self, course: Course, layout: Layout) -> np.ndarray:
        """What each coefficient does: (samples, size, actuators) in N, or (samples, size, points, 3) in N or m."""
        values, targets = course.of(self.variable, layout), self.targets(layout)
        if self.kind == "axial":
            found = np.zeros((len(values), self.size, values.shape[1]))
            shaped = self.shape.columns(values[:, targets], course.time)
            if self.times:
                other = course.of(self.times, layout)
                shaped = shaped * (other[:, targets] / self.most)[..., None]
            found[:, :, targets] = shaped.transpose(0, 2, 1)
            return found
        found = np.zeros((len(course.points), self.size, layout.points, 3))
        for k in targets:
            found[:, :, k] = self._at_point(course, layout, k)
        return found

    def _at_point(self, course: Course, layout: Layout, point: int) -> np.ndarray:
        """(samples, size, 3) at one point."""
        if self.variable == "speed":
            velocity = course.rate(course.points[:, point])
            speed = np.linalg.norm(velocity, axis=1, keepdims=True)
            most = self.most
            if self.kind == "measurement":
                return np.stack([velocity, speed * velocity / most], axis=1)
            return -np.stack([velocity / np.hypot(speed, SLOW * most), velocity / most, speed * velocity / most**2], axis=1)
        if self.variable == "time":
            shaped = self.shape.columns(course.of("time", layout)[:, 0], course.time)
        elif isinstance(self.shape, Powers):
            shaped = self.shape.columns(course.points[:, point], course.time)
        else:
            each = self.shape.columns(course.points[:, point], course.time)  # a spline of every axis for the force along it
            found = np.zeros((len(each), self.size, 3))
            for axis in range(3):
                found[:, axis * self.shape.size : (axis + 1) * self.shape.size, axis] = each[:, axis]
            return found
        found = np.zeros((len(shaped), self.size, 3))
        for axis in range(3):
            found[:, axis * self.shape.size : (axis + 1) * self.shape.size, axis] = shaped
        return found


def places(layout: Layout, courses: Sequence[Course]) -> list[Place]:
    """All places of a robot, with shapes over what the runs visit."""

    def visited(variable: str) -> np.ndarray:
        return np.concatenate([course.of(variable, layout).reshape(course.run.rows, -1) for course in courses])

    static = all(course.static for course in courses)
    found: list[Place] = []
    for variable, pieces, alone, knots in (
        ("pressure", 4, True, Spline.from_zero),
        ("tension", 3, True, Spline.from_zero),
        ("length", 3, True, Spline.over),
        ("rate", 3, True, Spline.over),
        ("neighbours", 2, False, Spline.over),
        ("time", 3, False, Spline.over),
    ):
        values = visited(variable)
        if np.ptp(values) > 0:
            shape = knots(values.ravel(), pieces)
            found += [Place("axial", target, variable, shape) for target in (ALL, *(layout.actuator_names if alone else ()))]
    for variable, times in (("supply", "pressure"), ("length", "pressure")):
        if np.ptp(visited(variable)) > 0:
            most = float(visited(times).max())
            found.append(Place("axial", ALL, variable, Spline.over(visited(variable).ravel(), 2), times=times, most=most))
    for variable, alone in (("pressure", True), ("tension", False), ("length", False)) if not static else ():
        reach = float(np.ptp(visited(variable)))
        targets = (ALL, *(layout.actuator_names if alone else ()))
        if reach > 0:
            found += [Place("axial", target, variable, Lags(LAGS, reach), "late") for target in targets]
            found += [Place("axial", target, variable, Plays(tuple(r * reach for r in RADII), reach), "remembered") for target in targets]
    points = np.concatenate([course.points for course in courses])
    last = layout.point_names[-1]
    found.append(Place("force", last, "position", Spline.over(points[:, -1].ravel(), 2)))
    fastest = [max(float(np.linalg.norm(c.rate(c.points[:, k]), axis=1).max()) for c in courses) or 1.0 for k in range(layout.points)]
    if not static:
        found += [
            Place("force", point, "speed", Powers((), (), 0), most=most) for point, most in zip(layout.point_names, fastest, strict=True)
        ]
    found += [Place("measurement", ALL, "position", Powers.over(points.reshape(-1, 3), 3))]
    found += [Place("measurement", name, "position", Powers.over(points[:, k], 1)) for k, name in enumerate(layout.point_names)]
    if not static:
        session = Spline.over(visited("time").ravel(), 3)
        for target, most in ((ALL, fastest[-1]), *zip(layout.point_names, fastest, strict=True)):
            found += [Place("measurement", target, "time", session), Place("measurement", target, "speed", Powers((), (), 0), most=most)]
    return found

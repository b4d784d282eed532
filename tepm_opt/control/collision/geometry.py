"""Obstacles that a robot shall keep out of: spheres, boxes and a table, from a file, with signed distances and normals."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from tepm_opt.data.documents import Number, Section, Vector, read_toml, require_range, validate
from tepm_opt.data.sizes import FARTHEST
from tepm_opt.solvers.planning.program import HalfSpace, Obstacle, Sphere, TurnedBox

MARGIN = 0.010  # m
TABLE = "table"

Name = Annotated[str, Field(min_length=1, description="any text")]
Margin = Annotated[float, require_range(0, 1, "m")]
Size = Annotated[float, require_range(1e-4, 10, "m")]
Place = Annotated[tuple[Number, Number, Number], Field(description="three numbers in m")]
UP = np.array([0.0, 0.0, 1.0])


class SphereObstacle(Section):
    """A sphere in the tracker frame G."""

    name: Name
    centre_m: Place
    radius_m: Size
    margin_m: Margin | None = None

    @model_validator(mode="after")
    def _metres(self) -> SphereObstacle:
        _check_distance("centre_m", self.centre_m)
        return self

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distances of points (n, 3) in m, negative inside, (n,), and the directions away from the sphere, (n, 3)."""
        apart = points - np.array(self.centre_m)
        length = np.linalg.norm(apart, axis=1)
        return length - self.radius_m, np.where(length[:, None] > 0, apart / np.maximum(length, 1e-300)[:, None], UP)

    def for_planning(self, margin: float) -> Obstacle:
        """The sphere, larger by a margin in m, for programs of planning."""
        return Sphere(self.centre_m, self.radius_m + margin)


class BoxObstacle(Section):
    """A box in the tracker frame G; its rotation is a rotation vector about its centre."""

    name: Name
    centre_m: Place
    size_m: Annotated[tuple[Size, Size, Size], Field(description="three numbers, 0.0001 … 10 m")]
    rotation_deg: Vector = (0.0, 0.0, 0.0)
    margin_m: Margin | None = None

    @model_validator(mode="after")
    def _metres(self) -> BoxObstacle:
        _check_distance("centre_m", self.centre_m)
        return self

    @cached_property
    def _turn(self) -> np.ndarray:
        return Rotation.from_rotvec(np.deg2rad(self.rotation_deg)).as_matrix()

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distances of points (n, 3) in m, negative inside, (n,), and the directions away from the box, (n, 3)."""
        own = (points - np.array(self.centre_m)) @ self._turn
        beyond = np.abs(own) - np.array(self.size_m) / 2
        outer = np.maximum(beyond, 0.0)
        length = np.linalg.norm(outer, axis=1)
        face = np.eye(3)[np.argmax(beyond, axis=1)]  # the nearest one, for points inside
        way = np.where(length[:, None] > 0, outer / np.maximum(length, 1e-300)[:, None], face) * np.where(own < 0, -1.0, 1.0)
        return np.where(length > 0, length, beyond.max(axis=1)), way @ self._turn.T

    def for_planning(self, margin: float) -> Obstacle:
        """The box, larger by a margin in m on each side, for programs of planning."""
        x, y, z = (side + 2 * margin for side in self.size_m)
        return TurnedBox(self.centre_m, (x, y, z), tuple(map(tuple, self._turn.tolist())))


class TableObstacle(Section):
    """A half space: all that is below a height, or behind a plane through a point, whose normal points to where the robot may be."""

    height_m: Annotated[float, require_range(-FARTHEST, FARTHEST, "m")] | None = None
    point_m: Place | None = None
    normal: Vector = (0.0, 0.0, 1.0)
    margin_m: Margin | None = None

    @model_validator(mode="after")
    def _one_way(self) -> TableObstacle:
        if (self.height_m is None) == (self.point_m is None):
            raise ValueError("height_m, or point_m with a normal; valid: one of the two")
        if self.height_m is not None and "normal" in self.model_fields_set:
            raise ValueError("height_m and normal; valid: height_m alone, or point_m with a normal")
        if not np.linalg.norm(self.normal) > 0:
            raise ValueError("normal is 0 long; valid: three numbers that are not all 0")
        if self.point_m is not None:
            _check_distance("point_m", self.point_m)
        return self

    @property
    def name(self) -> str:
        """Name of the table."""
        return TABLE

    @property
    def _plane(self) -> tuple[np.ndarray, np.ndarray]:
        """A point of the plane and its normal, 1 long."""
        point = np.array(self.point_m) if self.point_m is not None else UP * (self.height_m or 0.0)
        return point, np.array(self.normal) / np.linalg.norm(self.normal)

    def for_planning(self, margin: float) -> Obstacle:
        """The half space, its plane a margin in m nearer, for programs of planning."""
        point, normal = self._plane
        (x, y, z), (a, b, c) = (point + margin * normal).tolist(), normal.tolist()
        return HalfSpace((x, y, z), (a, b, c))

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distances of points (n, 3) in m, negative inside, (n,), and the directions away from the table, (n, 3)."""
        point, normal = self._plane
        return (points - point) @ normal, np.broadcast_to(normal, points.shape)


def _check_distance(key: str, place: tuple[float, float, float]) -> None:
    if max(map(abs, place)) > FARTHEST:
        raise ValueError(f"{key} = {list(place)}: further than {FARTHEST:g} m from the tracker; valid: metres, not millimetres")


class ObstacleFile(Section):
    """A file of obstacles; `margin_m` is what is kept from each that has no margin of its own."""

    margin_m: Margin = MARGIN
    spheres: tuple[SphereObstacle, ...] = ()
    boxes: tuple[BoxObstacle, ...] = ()
    table: TableObstacle | None = None

    @model_validator(mode="after")
    def _named_once(self) -> ObstacleFile:
        names = [each.name for each in self.shapes]
        if not names:
            raise ValueError("there is no obstacle in it; valid: [[spheres]], [[boxes]], [table]")
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"two obstacles are named {twice[0]!r}; valid: names of their own")
        return self

    @property
    def shapes(self) -> tuple[SphereObstacle | BoxObstacle | TableObstacle, ...]:
        """All obstacles: spheres, boxes, table."""
        return (*self.spheres, *self.boxes, *((self.table,) if self.table else ()))


@dataclass(frozen=True)
class Obstacles:
    """Obstacles in the tracker frame G.

    Attributes:
        file: what a person wrote.
    """

    file: ObstacleFile

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the obstacles."""
        return tuple(each.name for each in self.file.shapes)

    @cached_property
    def margins(self) -> np.ndarray:
        """Distances that are to be kept, (obstacles,) in m."""
        return np.array([self.file.margin_m if each.margin_m is None else each.margin_m for each in self.file.shapes])

    def for_planning(self) -> tuple[Obstacle, ...]:
        """All of them with their margins, for programs of planning."""
        return tuple(each.for_planning(float(margin)) for each, margin in zip(self.file.shapes, self.margins, strict=True))

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distances of points (n, 3) in m in G to each obstacle, negative inside, (n, obstacles), and the outward normals there,
        (n, obstacles, 3)."""
        found = [each.nearest(points) for each in self.file.shapes]
        return np.stack([distance for distance, _ in found], axis=1), np.stack([normal for _, normal in found], axis=1)


def read_obstacles(path: str | Path) -> Obstacles:
    """Obstacles from a TOML file (docs/how-to/control.md has one with comments).

    Raises:
        InputError: unreadable file, no TOML (with the line), unknown or missing key, a value out of its range, a name given twice, nothing
            in it.
    """
    return Obstacles(validate(ObstacleFile, read_toml(path), str(path)))

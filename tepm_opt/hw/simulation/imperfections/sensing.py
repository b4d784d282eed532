"""Imperfections of what the tracker sees; noise, rate and latency belong to the tracker itself."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from tepm_opt.data.documents import require_range
from tepm_opt.errors import unknown_name
from tepm_opt.hw.simulation.imperfections.base import Imperfection, Sighting
from tepm_opt.hw.simulation.imperfections.body import Vector

Position = Annotated[float, require_range(-100, 100, "m")]


class SensorOffset(Imperfection):
    """Holder arms that are not compensated, by point: `offset_m = { s3 = [0.004, 0, 0] }`, in the plate's own frame: they turn with it."""

    offset_m: dict[str, Vector] = Field(default_factory=dict)

    def measure(self, measured: Sighting) -> np.ndarray:
        names, points = measured.layout.point_names, measured.points.copy()
        for name, offset in self.offset_m.items():
            if name not in names:
                raise unknown_name("point", name, names, "imperfections: sensor_offset: offset_m")
            number = names.index(name)
            points[number] += plate_rotation(measured, number) @ np.array(offset)
        return points


def plate_rotation(measured: Sighting, point: int) -> np.ndarray:
    """Rotation (3, 3) into G of the level of a reference point that fits its nodes best (Kabsch); two levels where it lies between two."""
    weights = measured.layout.point_weights[point]
    now = np.tensordot(weights, measured.nodes, axes=1)
    rest = np.tensordot(weights, measured.rest, axes=1)
    left, _, right = np.linalg.svd((now - now.mean(axis=0)).T @ (rest - rest.mean(axis=0)))
    return left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right


class FieldDistortion(Imperfection):
    """Metal near the tracker (foreign to SPEC section 5): points seem drawn towards it, by `size_m` close to it, half of it at `reach_m`.

    Further away the distortion falls with the cube of the distance, as a dipole's field.
    """

    size_m: Annotated[float, require_range(-0.1, 0.1, "m")] = 0.0
    metal_m: tuple[Position, Position, Position] = (0.25, 0.15, 0.10)
    reach_m: Annotated[float, require_range(1e-3, 10, "m")] = 0.25

    def measure(self, measured: Sighting) -> np.ndarray:
        away = np.array(self.metal_m) - measured.points
        distance = np.linalg.norm(away, axis=1, keepdims=True)
        return measured.points + self.size_m * away / np.maximum(distance, 1e-9) / (1 + (distance / self.reach_m) ** 3)


class SensorMisalignment(Imperfection):
    """The tracker's frame is rotated about and shifted against the assumed G: seen = R p + shift."""

    rotation_deg: Vector = (0.0, 0.0, 0.0)
    shift_m: Vector = (0.0, 0.0, 0.0)

    def measure(self, measured: Sighting) -> np.ndarray:
        rotation = Rotation.from_rotvec(np.deg2rad(self.rotation_deg)).as_matrix()
        return measured.points @ rotation.T + np.array(self.shift_m)

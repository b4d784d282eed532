"""Poses of what optical trackers send: a position and a quaternion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation


def marker_position(position: Sequence[float]) -> np.ndarray | None:
    """Position of a marker, (3,); None where it is lost: not finite, or exactly the origin, which is sent in its place.

    Args:
        position: as the server sends it, in any unit.
    """
    found = np.asarray(position, dtype=float)
    return found if np.isfinite(found).all() and found.any() else None


def rigid_body_pose(position: Sequence[float], quaternion: Sequence[float]) -> np.ndarray | None:
    """Pose of a rigid body, (4, 4); None where it is lost: as for a marker, or with a quaternion that is no rotation.

    Args:
        position: as the server sends it, in any unit.
        quaternion: x, y, z, w.
    """
    place, turn = marker_position(position), np.asarray(quaternion, dtype=float)
    if place is None or not np.isfinite(turn).all() or not turn.any():
        return None
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_quat(turn).as_matrix(), place
    return pose

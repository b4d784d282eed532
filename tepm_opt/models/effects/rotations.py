"""Rotation matrices of symbols."""

from __future__ import annotations

import casadi as ca


def rotation(x: ca.SX, y: ca.SX, z: ca.SX) -> ca.SX:
    """Rotation by z about z, then by y about y, then by x about x (fixed axes, rad)."""
    about_x, about_y, about_z = (ca.SX.eye(3) for _ in range(3))
    for matrix, (i, j), angle in ((about_x, (1, 2), x), (about_y, (2, 0), y), (about_z, (0, 1), z)):
        matrix[i, i] = matrix[j, j] = ca.cos(angle)
        matrix[j, i] = ca.sin(angle)
        matrix[i, j] = -matrix[j, i]
    return about_x @ about_y @ about_z

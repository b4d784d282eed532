"""Levels moved by rotations, in Python: what statics and time stepping share (see rotations.c)."""

from __future__ import annotations

import numpy as np


def rotate(rotation: np.ndarray, vectors: np.ndarray, changes: np.ndarray) -> np.ndarray:
    """Rotate vectors by rotation vectors (all (…, 3)), after their linear changes less what the rotation accounts for."""
    e = vectors + changes - np.cross(rotation, vectors)
    angle = np.linalg.norm(rotation, axis=-1, keepdims=True)
    once = np.cross(rotation, e)
    s = np.sinc(angle / np.pi)
    c = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    return e + s * once + c * np.cross(rotation, once)


def move(x: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Levels x (n + 1, block) moved by a step, each level as a rotation plus the rest, so that bending keeps lengths."""
    nodes, changes = (array.reshape(len(x), -1, 3) for array in (x, step))
    centres, d_centres = nodes.mean(axis=1), changes.mean(axis=1)
    r, d = nodes - centres[:, None], changes - d_centres[:, None]
    inertia = np.einsum("lik,lik->l", r, r)[:, None, None] * np.eye(3) - np.einsum("lip,liq->lpq", r, r)
    turn = np.linalg.solve(inertia, np.cross(r, d).sum(axis=1)[..., None])[..., 0]
    links = rotate((turn[1:] + turn[:-1]) / 2, np.diff(centres, axis=0), np.diff(d_centres, axis=0))
    moved = np.concatenate([centres[:1], centres[:1] + np.cumsum(links, axis=0)])
    return (moved[:, None] + rotate(turn[:, None], r, d)).reshape(x.shape)

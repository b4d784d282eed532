"""Statics of a slender body that bends under tendons and weight: a Kirchhoff rod in pieces of constant curvature.

Arrays have components first and pieces last: (3, sets, rows, pieces), where sets are of parameters and rows of inputs. The body's frame has
z along it; weight pulls along z of the frame that its base is given in. Moments are over any reference: only their ratios matter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Bent:
    """A body in equilibrium.

    Attributes:
        rates: of turn about x and y of the body along it, (2, sets, rows, pieces) in rad/m.
        steps: lengths of the pieces, (sets, rows, pieces) in m.
        nodes: beginnings of the pieces, (3, sets, rows, pieces) in m.
        turns: frames there as quaternions, real part first, (4, sets, rows, pieces).
    """

    rates: np.ndarray
    steps: np.ndarray
    nodes: np.ndarray
    turns: np.ndarray

    def point_at(self, station: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """A point of a cross-section, (3, sets, rows) in m.

        Args:
            station: of the cross-section, in parts of the body's length, (sets, rows); beyond its ends the curvature stays.
            x, y: distances from the axis along x and y of the body, (sets, rows) in m each.
        """
        shape, pieces = self.steps.shape[:-1], self.steps.shape[-1]
        station = np.broadcast_to(station, shape) * pieces
        piece = np.clip(station.astype(int), 0, pieces - 1)
        one, other = np.indices(shape)
        rates, node, turn = (each[:, one, other, piece] for each in (self.rates, self.nodes, self.turns))
        way = (station - piece) * self.steps[one, other, piece]
        along_x, along_y, _ = axes(multiply_quaternions(turn, rotation_quaternion(rates * way)))
        return node + way * axes(multiply_quaternions(turn, rotation_quaternion(rates * way / 2)))[2] + x * along_x + y * along_y


def equilibrium(
    pulls: Callable[[np.ndarray], np.ndarray], stiffness: np.ndarray, weight: np.ndarray, steps: np.ndarray, base: np.ndarray
) -> Bent:
    """The shape in which a body's stiffness balances its tendons and its weight, by Newton's method on the rates of turn of all pieces.

    Steps are damped by the distance from equilibrium (pseudo-transient continuation; Kelley and Keyes, SIAM J. Numer. Anal. 35, 1998).

    Args:
        pulls: (angle turned from the base to the middle of each piece, (sets, rows, pieces) in rad) → moments of the tendons about x and
            y of the body there, (2, sets, rows, pieces).
        stiffness: against bending, (sets, rows, pieces), in the unit of moments times m.
        weight: of the pieces, (sets, rows, pieces), in the unit of moments per m.
        steps: lengths of the pieces, (sets, rows, pieces) in m.
        base: turn of the base as a vector, (3, sets, rows) in rad.

    Raises:
        RuntimeError: none is found.
    """
    shape = np.broadcast_shapes(stiffness.shape, weight.shape, steps.shape, (*base.shape[1:], 1))
    stiffness, weight, steps = (np.broadcast_to(each, shape) for each in (stiffness, weight, steps))
    start = rotation_quaternion(np.broadcast_to(base, (3, *shape[:-1])))[..., None]
    rates, inverse, sets = np.zeros((2, *shape)), None, 1
    for k in range(60):
        angle = np.sqrt((rates**2).sum(axis=0)) * steps
        moments = pulls(np.cumsum(angle, axis=-1) - angle / 2) + _weight_moments(rates, weight, steps, start)
        missing = moments / stiffness - rates
        if k == 20:  # until then all sets share the derivatives of the first
            inverse, sets = None, shape[0]
        if inverse is None:
            # three times the stiffness where a piece is to turn by 1 rad or more
            damping = 3.0 * np.minimum(np.abs(missing * steps)[:, :sets].max(axis=(0, -1)), 1.0)
            near = rates[:, :sets], stiffness[:sets], weight[:sets], steps[:sets], start[:, :sets]
            inverse = _inverse(*near, damping)
        whole = np.concatenate(list(missing), axis=-1)[..., None]
        change = np.stack(np.split((inverse @ whole)[..., 0], 2, axis=-1))
        rates = rates + change
        moved, size = np.abs(change).max(axis=(0, 2, 3)), np.abs(rates).max()
        if moved.max() <= 1e-9 * size:
            return Bent(rates, steps, *_find_nodes(rates, steps, start))
        if not moved[:sets].max() <= 1e-3 * size:  # nearer than that the derivatives are kept
            inverse = None
    raise RuntimeError("the body finds no equilibrium")


def _find_nodes(rates: np.ndarray, steps: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Beginnings of the pieces, and their frames there as quaternions."""
    turns = np.concatenate([start * np.ones_like(rates[0, ..., :1]), rotation_quaternion(rates * steps)[..., :-1]], axis=-1)
    reach = 1
    while reach < turns.shape[-1]:  # products of two, four, … turns
        turns = np.concatenate([turns[..., :reach], multiply_quaternions(turns[..., :-reach], turns[..., reach:])], axis=-1)
        reach *= 2
    way = steps * axes(multiply_quaternions(turns, rotation_quaternion(rates * steps / 2)))[2]
    return np.cumsum(way, axis=-1) - way, turns


def _weight_moments(rates: np.ndarray, weight: np.ndarray, steps: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Moments of the weight beyond the middle of each piece, about x and y of the body there."""
    nodes, turns = _find_nodes(rates, steps, start)
    x, y, z = axes(multiply_quaternions(turns, rotation_quaternion(rates * steps / 2)))
    at = (nodes + steps / 2 * z)[:2]
    beyond = np.cumsum(weight[..., ::-1], axis=-1)[..., ::-1] - weight
    load = weight * at
    arm = np.cumsum(load[..., ::-1], axis=-1)[..., ::-1] - load - beyond * at  # of all that is beyond, times its weight
    return np.stack([arm[1] * axis[0] - arm[0] * axis[1] for axis in (x, y)])


def _inverse(
    rates: np.ndarray, stiffness: np.ndarray, weight: np.ndarray, steps: np.ndarray, start: np.ndarray, damping: np.ndarray
) -> np.ndarray:
    """Inverse of the derivatives of the equations of equilibrium without those of the tendons, (sets, rows, 2 · pieces, same).

    Args:
        rates, stiffness, weight, steps, start: see `equilibrium`.
        damping: of the stiffness, added to it, (sets, rows).
    """
    (_, sets, rows, pieces), count = rates.shape, 2 * rates.shape[-1]
    small = 1e-4  # rad/m, step of the differences
    shifts = small * np.eye(count).reshape(count, 2, 1, 1, pieces)
    moved = np.moveaxis(rates + shifts, 0, 1).reshape(2, count * sets, rows, pieces)
    many = [np.concatenate([each] * count, axis=-3) for each in (weight, steps, start)]
    after = _weight_moments(moved, *many).reshape(2, count, sets, rows, pieces)
    slope = (after - _weight_moments(rates, weight, steps, start)[:, None]) / (small * stiffness)  # component, by, sets, rows, pieces
    square = slope.transpose(2, 3, 0, 4, 1).reshape(sets, rows, count, count)
    return np.linalg.inv((1 + damping[..., None, None]) * np.eye(count) - square)


def multiply_quaternions(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Product of quaternions (4, …): the turn `one`, then in its frame `other`."""
    a, b, c, d = one
    e, f, g, h = other
    real = a * e - b * f - c * g - d * h
    return np.stack([real, a * f + b * e + c * h - d * g, a * g - b * h + c * e + d * f, a * h + b * g - c * f + d * e])


def rotation_quaternion(vector: np.ndarray) -> np.ndarray:
    """Quaternion (4, …) of a turn by a vector, (3, …) in rad, or (2, …) about x and y."""
    half = np.sqrt((vector**2).sum(axis=0)) / 2
    found = np.zeros((4, *half.shape))
    found[0] = np.cos(half)
    found[1 : 1 + len(vector)] = vector * np.sinc(half / np.pi) / 2
    return found


def axes(turn: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Axes x, y and z of the frame that a quaternion (4, …) turns to, (3, …) each."""
    a, b, c, d = turn
    x = np.stack([1 - 2 * (c * c + d * d), 2 * (b * c + a * d), 2 * (b * d - a * c)])
    y = np.stack([2 * (b * c - a * d), 1 - 2 * (b * b + d * d), 2 * (c * d + a * b)])
    z = np.stack([2 * (b * d + a * c), 2 * (c * d - a * b), 1 - 2 * (b * b + c * c)])
    return x, y, z

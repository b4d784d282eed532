"""LuGre friction: bristles that bend before they slide."""

from __future__ import annotations

import numpy as np


class LuGre:
    """Bristles with F = σ_0 z + σ_1 dz/dt and dz/dt = v − σ_0 |v| z / g(v).

    Advanced exactly for a constant v in the tick. Canudas de Wit, Olsson, Åström, Lischinsky, IEEE Trans. Autom. Control 40 (1995) 419.

    Args:
        shape: of the bristles.
        stiffness: σ_0 in N/m.
        damping: σ_1 in N s/m.
        breakaway: largest static over sliding friction; 1 is no Stribeck effect.
        stribeck: velocity in m/s over which friction falls to the sliding one.
    """

    def __init__(
        self, shape: tuple[int, ...], stiffness: float, damping: float = 0.0, breakaway: float = 1.0, stribeck: float = 1e-3
    ) -> None:
        self.bend = np.zeros(shape)
        self.stiffness, self.damping, self.breakaway, self.stribeck = stiffness, damping, breakaway, stribeck

    @property
    def scalars(self) -> tuple[float, float, float, float]:
        """Stiffness, damping, breakaway and Stribeck velocity."""
        return self.stiffness, self.damping, self.breakaway, self.stribeck

    def settle(self) -> np.ndarray:
        """Set all bristles upright; the force is then 0, (shape)."""
        self.bend = np.zeros_like(self.bend)
        return self.bend

    def step(self, rate: np.ndarray, sliding: np.ndarray | float, duration: float) -> np.ndarray:
        """Force against the motion at the start and the end of the tick, (2, shape) in N.

        Args:
            rate: v in m/s, (shape).
            sliding: friction force when sliding in N, (shape).
            duration: of the tick in s.
        """
        limit = sliding / self.stiffness
        if self.breakaway > 1:
            limit = limit * (1 + (self.breakaway - 1) * np.exp(-((rate / self.stribeck) ** 2)))
        before = np.minimum(np.maximum(self.bend, -limit), limit)
        goal = np.copysign(limit, rate)
        self.bend = goal + (before - goal) * np.exp(np.abs(rate) * (-duration / np.maximum(limit, 1e-12)))
        force = self.stiffness * np.array([before, self.bend])
        return force + self.damping / duration * (self.bend - before) if self.damping else force

"""Internal states of effects: what remembers, what saturates, what has play. Elementwise, with CasADi symbols."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True)
class Lag:
    """A first-order lag of all pressures.

    Attributes:
        filling, exhausting: time constants of rising and of falling pressures in s, as CasADi symbols; 0 is at once.
    """

    filling: ca.SX
    exhausting: ca.SX


@dataclass(frozen=True)
class Memory:
    """An internal state y that is 0 at rest and forgets: dy/dt = drive - decay / scale * y, elementwise.

    `decay` and `scale` stand apart because either may vanish: a lag has decay 1 and its time constant as scale, a
    rate-independent memory the absolute rate of its signal as decay and a distance as scale.
    """

    drive: ca.SX
    decay: ca.SX
    scale: ca.SX

    def rate(self, state: ca.SX, step: ca.SX | float) -> ca.SX:
        """dy/dt at the end of an implicit stage of length `step` that starts at `state`; at `state` itself for step 0."""
        return (self.scale * self.drive - self.decay * state) / (self.scale + step * self.decay)

    def after(self, state: ca.SX, time: ca.SX) -> ca.SX:
        """y after a time over which drive and decay stay as they are: the exact solution, for any scale down to 0."""
        z = time * self.decay / (self.scale + SHORTEST) + TINY
        return ca.exp(-z) * state - ca.expm1(-z) / z * time * self.drive


@dataclass(frozen=True)
class Saturating(Memory):
    """A memory of an input whose way back saturates: dy/dt = drive - decay y / (scale + slowing max(|y|, opening)), elementwise.

    Attributes:
        slowing: as a function of y and of the time left until the input is what it was when the memory was asked for.
        opening: |y| up to which the way back is in proportion to it.
    """

    slowing: Callable[[ca.SX, ca.SX], ca.SX]
    opening: ca.SX

    def after(self, state: ca.SX, time: ca.SX) -> ca.SX:
        """y after a time over which drive and decay stay as they are: by the slowing in the middle, exact where nothing slows it."""
        middle = state + time / 2 * self.drive
        for part in (time / 2, time):
            slowed = self.scale + self.slowing(middle, time / 2) * ca.fmax(ca.fabs(middle), self.opening)
            slowed = ca.if_else(slowed < 0, 0, slowed)  # with its slope at 0
            middle = Memory(self.drive, self.decay, slowed).after(state, part)
        return middle


@dataclass(frozen=True)
class Play:
    """An internal state of an input that goes against the input's changes until it reaches a limit, where it stays, elementwise.

    The play or backlash operator, its corner rounded: with the part e that is left to the limit,
    de/ds = -(1 - exp(-e / corner)) over the path s of the input.

    Attributes:
        limit: for the way the input goes now.
        rising: whether the input rises, so that the state falls.
        pace: the input's absolute rate.
        corner: over which sticking turns into following, above 0, in the input's unit.
    """

    limit: ca.SX
    rising: ca.SX
    pace: ca.SX
    corner: ca.SX

    def after(self, state: ca.SX, time: ca.SX) -> ca.SX:
        """y after a time at whose end the limit is this one: exact for a limit that stays."""
        sense = ca.if_else(self.rising, 1.0, -1.0)
        left, path = sense * (state - self.limit) / self.corner, time * self.pace / self.corner
        near = ca.exp(-path) * ca.expm1(ca.fmax(ca.fmin(left, 1), -BEYOND))
        far = ca.exp(ca.fmin(left - path, STRAIGHT)) - ca.exp(-path)
        rounded = ca.log1p(ca.if_else(left < 1, near, far))
        return self.limit + sense * self.corner * ca.if_else(left - path > STRAIGHT, left - path, rounded)


SHORTEST = 1e-12  # keeps quotients finite where a scale vanishes
TINY = 1e-30
BEYOND = 20.0  # corners behind a limit from where a state comes back at once
STRAIGHT = 40.0  # corners before a limit beyond which nothing is felt of it

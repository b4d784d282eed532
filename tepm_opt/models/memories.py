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

    def advance(self, state: ca.SX, time: ca.SX) -> ca.SX:
        """Advance y by a time over which drive and decay stay as they are: the exact solution, for any scale down to 0."""
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

    def advance(self, state: ca.SX, time: ca.SX) -> ca.SX:
        """Advance y by a time over which drive and decay stay as they are: by the slowing in the middle, exact where nothing slows it."""
        middle = state + time / 2 * self.drive
        for part in (time / 2, time):
            slowed = self.scale + self.slowing(middle, time / 2) * ca.fmax(ca.fabs(middle), self.opening)
            slowed = ca.if_else(slowed < 0, 0, slowed)  # with its slope at 0
            middle = Memory(self.drive, self.decay, slowed).advance(state, part)
        return middle


@dataclass(frozen=True)
class Play:
    """An internal state of an input that goes against the input's changes until it reaches a limit, where it stays, elementwise.

    Of the part e that is left to the limit, de/ds = -(1 - exp(-sticking e / distance)) / sticking over the path s of the input: an
    exponential for no sticking, the play or backlash operator with a round corner for 1.

    Attributes:
        limit: for the way the input goes now.
        rising: whether the input rises, so that the state falls.
        pace: the input's absolute rate.
        distance: over which the state comes to its limit, above 0, in the input's unit.
        sticking: 0 and above.
    """

    limit: ca.SX
    rising: ca.SX
    pace: ca.SX
    distance: ca.SX
    sticking: ca.SX

    def advance(self, state: ca.SX, time: ca.SX) -> ca.SX:
        """Advance y by a time at whose end the limit is this one: exact for a limit that stays.

        Where sticking hardly matters it is a series in it, which no quotient by it spoils.
        """
        sense = ca.if_else(self.rising, 1.0, -1.0)
        e, path = sense * (state - self.limit), time * self.pace / self.distance
        left, kept = self.sticking * e / self.distance, ca.exp(-path)
        matters = ca.fabs(left) > HARDLY
        near = kept * ca.expm1(ca.fmax(ca.fmin(left, 1), -BEYOND))
        far = ca.exp(ca.fmin(left - path, STRAIGHT)) - kept
        rounded = ca.log1p(ca.if_else(left < 1, near, far))
        bent = self.distance / ca.if_else(matters, self.sticking, 1) * ca.if_else(left - path > STRAIGHT, left - path, rounded)
        series = kept * e * (1 + (1 - kept) * left / 2 * (1 + (1 - 2 * kept) * left / 3))
        return self.limit + sense * ca.if_else(matters, bent, series)


SHORTEST = 1e-12  # keeps quotients finite where a scale vanishes
TINY = 1e-30
HARDLY = 1e-4  # e sticking / distance up to which a series to the third order is as good
BEYOND = 20.0  # corners behind a limit from where a state comes back at once
STRAIGHT = 40.0  # corners before a limit beyond which nothing is felt of it

"""Endings of solvers, fits, plans and loops: one vocabulary for all of them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Ending(StrEnum):
    """Kind of end of a piece of work; the values stand in summaries and logs."""

    SOLVED = "solved"
    DONE = "done"
    INTERRUPTED = "interrupted"
    NOT_CONVERGED = "not converged"
    FAILED = "failed"
    # equilibria
    UNSTABLE = "unstable"
    COLLAPSED = "collapsed"
    NO_INPUTS = "no inputs"
    # inverse kinematics and plans
    OUT_OF_REACH = "out of reach"
    BLOCKED = "blocked"
    NO_PLAN = "no plan found"
    # quadratic programs
    INFEASIBLE = "infeasible"
    ITERATION_LIMIT = "iteration limit"
    NOT_FINITE = "not finite"
    NOT_CONVEX = "not convex"
    # closed loops
    BLIND = "the tracker saw nothing"
    DISAGREED = "the rig and the reference disagree"
    LIMIT = "a measured tension or pressure is beyond its limit"
    UNMEASURED = "a tension or pressure is not measured any more"
    OVER = "the rig has no more samples"
    RIG_FAILED = "the rig failed"


PROPER = (Ending.SOLVED, Ending.DONE)
"""Endings of work that did what it was asked to."""


@dataclass(frozen=True)
class Outcome:
    """End of a piece of work and its reason.

    Attributes:
        ending: the kind of end.
        message: the explanation with its numbers, for people; empty where there is nothing to explain.
    """

    ending: Ending = Ending.SOLVED
    message: str = ""

    @property
    def solved(self) -> bool:
        """Whether it came to its proper end."""
        return self.ending in PROPER

    def __str__(self) -> str:
        return f"{self.ending}: {self.message}" if self.message else str(self.ending)


SOLVED = Outcome()
"""The outcome of what is solved and has nothing to explain."""

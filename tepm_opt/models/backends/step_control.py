"""When an implicit stage is solved and how long adaptive steps are: constants of both backends (see motion_adaptive.c)."""

from __future__ import annotations

from collections.abc import Mapping

SLOW = 0.2
"""Contraction of Newton's iterations above which the next one has a matrix of its own."""
FIRST_STEP = 2e-3
"""s: adaptive step to try from rest and after a jump."""
SHORTEST = 1e-8
"""s: adaptive step below which time stepping gives up."""
RICHARDSON = 7
"""2³ − 1: how often the error of a smooth adaptive motion goes into its distance from the one with steps twice as long. Twice the error
is stated; where effects have corners, the whole distance, which is the error at order 1."""
MEMORY = 20.0
"""s in which the errors that pairs of adaptive steps add, as steps of a random walk, may make up the one aimed at."""
MOST_OVER = 1.5
"""Times as much as aimed at that a pair of adaptive steps may add."""
LEAST = 0.2
"""Part of the error asked for below which errors are neither aimed at nor stated."""
SHARE = 0.1
"""Part of the way of a pair of adaptive steps that its error may be, however large the one aimed at."""
STILL = 1.0
"""s in which the way of a pair of adaptive steps is forgotten."""
CLOSE = 3e-3
"""Part of the error aimed at that an adaptive stage may be off."""

STEP_CONTROL: Mapping[str, float] = {
    "SLOW": SLOW,
    "FIRST_STEP": FIRST_STEP,
    "SHORTEST": SHORTEST,
    "RICHARDSON": RICHARDSON,
    "MEMORY": MEMORY,
    "MOST_OVER": MOST_OVER,
    "LEAST": LEAST,
    "SHARE": SHARE,
    "STILL": STILL,
    "CLOSE": CLOSE,
}
"""Constants that the C gets as macros."""

"""How long a controller takes."""

from __future__ import annotations

import time
from typing import Protocol

from tepm_opt.control.controller import Controller, Prepares
from tepm_opt.hw.rig import Sample

TRIALS = 30  # steps, of which a third is not counted


class PreparedController(Controller, Prepares, Protocol):
    """A controller that prepares."""


def computing_time(trial: PreparedController) -> float:
    """Longest time in s from a sample to the command of a controller, which stands at its start, prepared; at most its period."""
    reference, took = trial.reference, []
    for row in range(TRIALS):
        trial.prepare()
        began = time.perf_counter()
        trial.command(Sample(row * reference.period, reference.equilibria[0].points))
        took.append(time.perf_counter() - began)
    return min(max(took[TRIALS // 3 :]), reference.period)

"""Measurement of how long a control step takes."""

from __future__ import annotations

import math
import time

from tepm_opt.control.mpc.record import ControlStep
from tepm_opt.control.references.reference import Reference
from tepm_opt.hw.rig import Sample

TRIALS = 30  # steps, of which a third is not counted


def computing_time(step: ControlStep, reference: Reference) -> float:
    """Longest time in s from a sample to the command of a new step at the reference's start, prepared; at most a control period."""
    took = []
    for row in range(TRIALS):
        step.prepare()
        sample = Sample(row * reference.period, reference.equilibria[0].points)
        began = time.perf_counter()
        step.feedback(sample, math.inf)
        took.append(time.perf_counter() - began)
    return min(max(took[TRIALS // 3 :]), reference.period)

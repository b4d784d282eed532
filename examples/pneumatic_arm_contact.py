"""The soft arm with the lag of its body, which slow steps have shown: what else happened to it in a trial?"""

import casadi as ca
from pneumatic_arm import arm

from tepm_opt.discrepancy.adapters.equations import Equations
from tepm_opt.discrepancy.laws.axis import AXIS
from tepm_opt.discrepancy.laws.pneumatics import PNEUMATICS
from tepm_opt.discrepancy.laws.signals import OUTPUT


def inside(m: Equations, pressure: ca.SX, turning: ca.SX) -> tuple[ca.SX, ca.SX]:
    """A pressure that follows its command, and a spring on a damper beside the body's own."""
    held = m.state("held")
    filling, exhausting = m.parameter("filling", 0.3, "s", low=0.05, high=5.0), m.parameter("exhausting", 1.5, "s", low=0.05, high=5.0)
    m.rate(held, (pressure - held) / ca.if_else(pressure > held, filling, exhausting))
    creep, time = m.parameter("creep", 0.7, "1", low=0.0, high=3.0), m.parameter("creep_time", 2.0, "s", low=0.2, high=20.0)
    stretched = m.state("stretched")
    m.rate(stretched, turning - stretched / time)
    return held, creep * stretched


plant = arm((*PNEUMATICS, *AXIS, *OUTPUT), inside)

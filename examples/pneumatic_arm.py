"""A soft arm that one chamber bends: how it moves is known roughly, what happens between commanded pressure and bending is not."""

from collections.abc import Callable, Sequence
from math import pi

import casadi as ca

from tepm_opt.discrepancy.adapters.casadi_plant import CasadiPlant
from tepm_opt.discrepancy.adapters.equations import Equations
from tepm_opt.discrepancy.laws.axis import AXIS
from tepm_opt.discrepancy.laws.effect import Law
from tepm_opt.discrepancy.laws.pneumatics import PNEUMATICS
from tepm_opt.discrepancy.laws.signals import OUTPUT
from tepm_opt.discrepancy.laws.soft import SOFT

Inside = Callable[[Equations, ca.SX, ca.SX], tuple[ca.SX, ca.SX]]


def arm(laws: Sequence[Law], inside: Inside = lambda m, pressure, turning: (pressure, ca.SX(0))) -> CasadiPlant:
    """The arm; `inside` says which pressure acts, and what holds the body besides its spring, as a bending."""
    m = Equations("pneumatic arm", time=1.0, laws=laws)
    bend, turning = m.state("bend"), m.state("turning")
    pressure = m.input("pressure_psi", size=20.0, unit="psi")
    gain = m.parameter("gain", 0.03, "rad/psi", low=0.003, high=0.3)
    length = m.parameter("length", 0.18, "m", low=0.16, high=0.2)
    frequency = m.parameter("frequency", 2 * pi * 3, "rad/s", low=2 * pi * 1.5, high=2 * pi * 6)
    damping = m.parameter("damping", 0.5, "1", low=0.1, high=1.0)
    way = m.parameter("way", 0.8, "rad", low=-pi, high=pi)
    rest_x, rest_y = m.parameter("rest_x", 0.15, "rad", low=-1.0, high=1.0), m.parameter("rest_y", 0.15, "rad", low=-1.0, high=1.0)

    acting, holding = inside(m, pressure, turning)
    m.rate(bend, turning)
    effects = m.axis("bend", bend, turning, force=0.3, speed=0.3, position=0.3, unit="")
    m.rate(turning, frequency**2 * (gain * acting - bend - holding + effects) - 2 * damping * frequency * turning)

    x, y = rest_x + bend * ca.cos(way), rest_y + bend * ca.sin(way)
    angle = ca.sqrt(x**2 + y**2 + 1e-12)
    reach = length * (1 - ca.cos(angle)) / angle**2  # of a body bent evenly, per bending
    m.output("x", reach * x, "m", size=0.05, time=1e-3)
    m.output("y", reach * y, "m", size=0.05, time=1e-3)
    return m.plant()


plant = arm((*PNEUMATICS, *AXIS, *SOFT, *OUTPUT))

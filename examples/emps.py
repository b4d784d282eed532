"""A linear drive that others measured (EMPS; Janot, Gautier, Brunot 2019): mass and viscous friction are known, what else acts is not."""

from collections.abc import Callable

import casadi as ca

from tepm_opt.discrepancy.adapters.casadi_plant import CasadiPlant
from tepm_opt.discrepancy.adapters.equations import Equations
from tepm_opt.discrepancy.laws.axis import AXIS
from tepm_opt.discrepancy.laws.signals import OUTPUT


def drive(force: Callable[[Equations], ca.SX]) -> CasadiPlant:
    """The drive with whatever columns its force in N is written into."""
    m = Equations("EMPS", time=0.1, laws=(*AXIS, *OUTPUT))  # s, of a start or a stop; the force is what the motor's current tells
    q, v = m.state("q"), m.state("v")
    mass, viscous = m.parameter("mass", 100.0, "kg"), m.parameter("viscous", 200.0, "N s/m", within=0.5)
    missing = m.axis("slide", q, v, force=50.0, speed=0.1, position=0.1)
    m.rate(q, v)
    m.rate(v, (force(m) - viscous * v + missing) / mass)
    m.output("position", q, "m", size=0.1)
    return m.plant()


plant = drive(lambda m: m.input("force", size=50.0, unit="N"))

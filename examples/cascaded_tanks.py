"""Two tanks, one below the other: a pump fills the upper one, a gauge shows the level of the lower one; what else happens to the water?"""

import casadi as ca

from tepm_opt.discrepancy.adapters.equations import Equations

m = Equations("cascaded tanks", time=100.0)
upper, lower = m.state("upper", 5.0), m.state("lower", 5.0)
pump = m.input("pump", size=3.0)
filling = m.parameter("filling", 0.04, "1/s", low=0.005, high=0.3)
through, out = m.parameter("through", 0.05, "V^0.5/s", low=0.005, high=0.3), m.parameter("out", 0.05, "V^0.5/s", low=0.005, high=0.3)
zero = m.parameter("zero", 0.0, "V", low=-3.0, high=3.0)


def flow(level: ca.SX) -> ca.SX:
    """Through a hole in the bottom goes what the root of the level tells (Torricelli)."""
    return ca.sqrt(ca.fmax(level, 1e-4))


over = m.vessel("upper", upper, filling * pump - through * flow(upper), size=10.0, unit="V")
m.vessel("lower", lower, through * flow(upper) + over - out * flow(lower), size=10.0, unit="V", last=True)
m.output("level", lower + zero, "V", size=10.0)
plant = m.plant(substeps=4, between="hold")

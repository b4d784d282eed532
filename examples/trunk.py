"""A tendon trunk of Stanford's ASL, its tip alone: bent evenly as a whole in two planes by six pairs of tendons.

Set points of the motors (deg) go in, the tip's place (m, y up) is measured. Motion tells only ratios of mass to stiffness, so that the
trunk's own mass is set to `MASS`; a payload is found in the same measure, of which one known payload tells the scale.
"""

import casadi as ca

from tepm_opt.discrepancy.adapters.equations import Equations

GRAVITY, LENGTH, MASS = 9.81, 0.316, 0.15  # m/s2, m, kg

m = Equations("trunk", time=0.3)  # s, of a swing
bend = ca.vertcat(m.state("bend_x"), m.state("bend_z"))  # rad, at the tip
rate = ca.vertcat(m.state("rate_x"), m.state("rate_z"))
pulled = ca.vertcat(m.state("pulled_x"), m.state("pulled_z"))
motors = [m.input(f"u{k}", size=30.0, unit="deg") for k in range(1, 7)]


def pull(axis: str, gains: list[float]) -> ca.SX:
    """Bend in rad to which the tendons would pull a trunk without weight."""
    each = [m.parameter(f"{axis}_{k}", gain, "rad/deg", low=gain - 0.01, high=gain + 0.01) for k, gain in enumerate(gains, 1)]
    return m.parameter(f"rest_{axis}", 0.0, "rad", low=-0.3, high=0.3) + sum(gain * u for gain, u in zip(each, motors, strict=True))


asked = ca.vertcat(pull("x", [0.007, -0.002, -0.006, -0.007, -0.003, 0.007]), pull("z", [-0.007, -0.007, 0.0, 0.002, 0.006, 0.008]))
stiffness = m.parameter("stiffness", 1.0, "N m/rad", low=0.1, high=5.0)
damping = m.parameter("damping", 0.02, "s", low=0.002, high=0.2)  # of the stiffness
trail = m.parameter("trail", 0.15, "s", low=0.03, high=0.5)  # of the motors behind their set points
yielding = m.parameter("yielding", 0.3, "1/rad2", low=0.0, high=10.0)  # the gain falls with amplitude
rise = m.parameter("rise", 1 / 6, "1", low=0.08, high=0.5)  # of the tip, in parts of the length
places = [m.parameter(name, value, "m", low=value - 0.05, high=value + 0.05) for name, value in (("x0", 0.1), ("y0", 0.0), ("z0", 0.105))]

turned = ca.sumsqr(bend)
across = LENGTH / 2 * bend * (1 - turned / 12)
height = -LENGTH * (1 - rise * turned)
mass = MASS + m.mass("tip", size=0.1)
other = ca.vertcat(*(m.axis(f"bend_{n}", bend[k], rate[k], force=0.2, speed=2.0, position=0.5, unit="rad") for k, n in enumerate("xz")))
drawn = pulled / ca.sqrt(1 + yielding * ca.sumsqr(pulled))
moments = stiffness * (drawn - bend - damping * rate) - mass * GRAVITY * ca.gradient(height, bend) + other
for k in range(2):
    m.rate(pulled[k], (asked[k] - pulled[k]) / trail)
    m.rate(bend[k], rate[k])
    m.rate(rate[k], moments[k] / (mass * (LENGTH / 2) ** 2))
for name, value, place in zip(("x3", "y3", "z3"), (across[0], height, across[1]), places, strict=True):
    m.output(name, value + place, "m", size=0.05, time=0.01)

plant = m.plant(substeps=2)

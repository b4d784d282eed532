"""An arm of two links that hangs in gravity: torques at shoulder and elbow go in, the joints' angles are measured."""

import casadi as ca

from tepm_opt.discrepancy.adapters.equations import Equations

GRAVITY = 9.81  # m/s²
LENGTH = 0.4  # m, from shoulder to elbow
MASS, CENTRE, INERTIA = (1.5, 1.0), (0.2, 0.15), (0.02, 0.0075)  # kg, m from the joint, kg m² about the centre; upper arm, forearm

m = Equations("two-link arm", time=0.5)  # s, of a swing

shoulder, elbow = m.state("shoulder"), m.state("elbow")  # rad: from hanging down, and relative to the upper arm
d_shoulder, d_elbow = m.state("shoulder rate"), m.state("elbow rate")
torques = ca.vertcat(m.input("torque_1", size=3.0, unit="N m"), m.input("torque_2", size=1.0, unit="N m"))
upper, fore = m.parameter("upper_mass", MASS[0], "kg", within=0.1), m.parameter("fore_mass", MASS[1], "kg", within=0.1)
damping = m.parameter("damping", 0.1, "N m s/rad", within=0.8)

q, dq = ca.vertcat(shoulder, elbow), ca.vertcat(d_shoulder, d_elbow)
coupling = fore * LENGTH * CENTRE[1] * ca.cos(elbow)
alone = INERTIA[1] + fore * CENTRE[1] ** 2
first = INERTIA[0] + upper * CENTRE[0] ** 2 + alone + fore * LENGTH**2 + 2 * coupling
inertia = ca.vertcat(ca.horzcat(first, alone + coupling), ca.horzcat(alone + coupling, alone))
turning = fore * LENGTH * CENTRE[1] * ca.sin(elbow)
velocity = ca.vertcat(-turning * d_elbow * (2 * d_shoulder + d_elbow), turning * d_shoulder**2)
outer = fore * CENTRE[1] * ca.sin(shoulder + elbow)
weight = GRAVITY * ca.vertcat((upper * CENTRE[0] + fore * LENGTH) * ca.sin(shoulder) + outer, outer)
missing = ca.vertcat(
    m.axis("shoulder", shoulder, d_shoulder, force=3.0, speed=3.0, unit="rad"),
    m.axis("elbow", elbow, d_elbow, force=1.0, speed=3.0, unit="rad"),
)
rates = ca.solve(inertia, torques - velocity - weight - damping * dq + missing)
for state, rate in zip((shoulder, elbow, d_shoulder, d_elbow), (*ca.vertsplit(dq), *ca.vertsplit(rates)), strict=True):
    m.rate(state, rate)
m.output("angle_1", shoulder, "rad")
m.output("angle_2", elbow, "rad")

plant = m.plant(substeps=2)

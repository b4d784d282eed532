"""An electronic circuit that imitates a mass on a spring (Wigren and Schoukens 2013): what else is in it?"""

from math import pi

from tepm_opt.discrepancy.adapters.equations import Equations

m = Equations("Silverbox", time=1 / (2 * pi * 66))  # s, of its swing over 2 pi
y, v = m.state("y"), m.state("v")
voltage = m.input("input", size=0.1, unit="V")
gain = m.parameter("gain", 1.8e5, "1/s2", low=0.5e5, high=4e5)
damping = m.parameter("damping", 20.0, "1/s", low=1.0, high=100.0)
stiffness = m.parameter("stiffness", (2 * pi * 67) ** 2, "1/s2", within=0.15)
m.rate(y, v)
m.rate(v, gain * voltage - damping * v - stiffness * y + m.axis("spring", y, v, force=2e4, speed=40.0, position=0.1, unit=""))
m.output("position", y, "V", size=0.1)
plant = m.plant(substeps=4, between="band")

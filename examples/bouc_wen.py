"""A mass on a spring with a memory (Noël and Schoukens 2016), of which mass, damper and spring are known roughly."""

from tepm_opt.discrepancy.adapters.equations import Equations

m = Equations("Bouc-Wen", time=0.01)  # s, of a swing over 2 pi, about
q, v = m.state("q"), m.state("v")
force = m.input("force", size=100.0, unit="N")
mass = m.parameter("mass", 2.0, "kg", within=0.2)
damper = m.parameter("damper", 20.0, "N s/m", low=1.0, high=200.0)
spring = m.parameter("spring", 8e4, "N/m", low=2e4, high=2e5)
m.rate(q, v)
m.rate(v, (force - damper * v - spring * q + m.axis("guide", q, v, force=50.0, speed=0.1, position=1e-3)) / mass)
m.output("position", q, "m", size=1e-3)
plant = m.plant(substeps=4, between="band")

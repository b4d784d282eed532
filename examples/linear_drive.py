"""A linear drive: a motor pushes a carriage along a rail, an encoder tells where it is. Mass and viscous friction are known roughly."""

from tepm_opt.discrepancy.adapters.equations import Equations

m = Equations("linear drive", time=0.2)  # s, of a start or a stop

position, speed = m.state("position"), m.state("speed")
force = m.input("force", size=50.0, unit="N")
mass = m.parameter("mass", 10.0, "kg", within=0.2)
viscous = m.parameter("viscous", 40.0, "N s/m", within=0.5)

missing = m.axis("rail", position, speed, force=50.0, speed=0.5, position=0.2)  # whatever else may act along the rail
m.rate(position, speed)
m.rate(speed, (force - viscous * speed + missing) / mass)
m.output("encoder", position, "m", size=0.2)

plant = m.plant(substeps=4, between="hold")  # the controller holds its force from sample to sample

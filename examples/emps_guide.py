"""The same drive, its force written down as a pressure that pushes and a tension that pulls, neither of which can be negative."""

from emps import drive

AREA = 1e-4  # m²

plant = drive(lambda m: AREA * m.input("pressure", size=5e5, unit="Pa") - m.input("tension", size=50.0, unit="N"))

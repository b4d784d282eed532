"""The same drive, its force written down as a force on the tip in kN."""

from emps import drive

plant = drive(lambda m: 1e3 * m.input("tip_force_x_kN", size=0.05, unit="kN"))

"""A motor as a transfer function of the control library: voltage in, speed out, both effects that may be missing written down here."""

import control
import numpy as np

from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.adapters.callable_plant import Simulator
from tepm_opt.discrepancy.laws.effect import Law, Quantity

m = Simulator("motor", Signals.from_names(["voltage"], ["speed"], "rad/s"))
m.parameter("gain", 12.0, "rad/s/V")
m.parameter("time", 0.3, "s", within=0.3)

stick = Law(
    "dead_zone", "input", (Quantity("width", "signal", 0.0, (0.01, 0.1), 0.0, 1.0),), smooth=False, explains="low voltages do nothing"
)
slow = Law("filter", "output", (Quantity("time", "time", 0.0, (0.1, 1.0), 0.0, 10.0),), smooth=False, explains="the tachometer lags")
m.effects([stick], "voltage", "V", signal=10.0)
m.effects([slow], "speed", time=0.3)


def simulate(run, values):
    """The speed at the samples of a run, (rows,)."""
    voltage, width = run.inputs[:, 0], values["dead_zone[voltage].width"]
    system = control.TransferFunction([values["gain"]], [values["time"], 1])
    if values["filter[speed].time"] > 1e-4:
        system = system * control.TransferFunction([1], [values["filter[speed].time"], 1])
    return control.forced_response(control.ss(system), run.time - run.time[0], voltage - np.clip(voltage, -width, width)).outputs


plant = m.plant(simulate)

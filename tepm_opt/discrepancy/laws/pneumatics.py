"""Effects between a commanded pressure and the one in the chamber: valves of finite flow, leaks, regulators that are off."""

from __future__ import annotations

import casadi as ca

from tepm_opt.discrepancy.laws.effect import At, Law, Quantity
from tepm_opt.discrepancy.laws.signals import INPUT, follow, time_constant


def _choke(name: str) -> Quantity:
    """Time of a change by the usual pressure at the highest flow."""
    return time_constant(name, (0.3, 3.0), shape=True)


def _lag(at: At) -> tuple[ca.SX, list[ca.SX]]:
    """The regulator asks for a rate in proportion to the pressure difference; the highest flow limits that rate.

    Both are slower the larger the volume: that of the tubes at no pressure, and that of a chamber that gives way.
    """
    (z,), p, size, rises = at.z, at.p, at.sizes["signal"], at.signal > at.z[0]
    volume = ca.fmax(1 + p["growth"] * z / size, 0.1)
    time = volume * ca.if_else(rises, p["filling"], p["exhausting"])
    most = size / ca.fmax(volume * ca.if_else(rises, p["filling_choke"], p["exhausting_choke"]), 1e-3 * at.step)
    asked = (at.signal - z) / ca.fmax(time, 2 * at.step)
    return follow(at, ca.fmin(ca.fmax(asked, -most), most), ca.fmax(p["filling"], p["exhausting"]))


def _leak(at: At) -> tuple[ca.SX, list[ca.SX]]:
    """The flow through a hole, and with it the loss of pressure, grows with the root of the pressure."""
    size = at.sizes["signal"]
    return at.signal - at.p["loss"] * ca.sqrt(size) * ca.sqrt(ca.fmax(at.signal, 1e-6 * size)), []


PNEUMATICS = (
    Law(
        "pressure_lag", "input",
        (
            time_constant("filling"), time_constant("exhausting"), _choke("filling_choke"), _choke("exhausting_choke"),
            Quantity("growth", "1", 0.0, (0.5,), -0.5, 5.0, shape=True),
        ),
        _lag, states=1, smooth=False, reference="ISO 6358 for the highest flow",
        explains="the pressure follows its command with a lag, one time to fill, another to exhaust; a change by the usual pressure takes "
        "at least the choke; growth of the chamber's volume, over the tubes', makes all of it slower",
    ),
    Law(
        "leak", "input", (Quantity("loss", "1", 0.0, (0.01, 0.1), 0.0, 1.0),), _leak,
        explains="pressure is lost through a hole, in proportion to the flow through it", reference="Torricelli 1643",
    ),
    *(law for law in INPUT if law.name in {"time_delay", "input_gain", "input_offset", "input_dead_zone"}),
)  # fmt: skip
"""Effects between a commanded pressure and the chamber: for inputs that are pressures, in the place of `signals.INPUT`."""

"""What happens between a commanded pressure and the one in the chamber: valves of finite flow, leaks, regulators that are off."""

from __future__ import annotations

import casadi as ca

from tepm_opt.discrepancy.library.effect import At, Law, Quantity
from tepm_opt.discrepancy.library.signals import INPUT, TIMES, follow

LAG = "lag"  # forms of the same: the pressure comes later than its command
CHOKES = (0.1, 1.0)  # of the machine's own time: what a change by the usual pressure takes at the highest flow


def _time(name: str, probes: tuple[float, ...] = TIMES) -> Quantity:
    return Quantity(name, "time", 0.0, probes, 0.0, 30.0)


def _asked(at: At) -> ca.SX:
    """Rate that a regulator asks for: in proportion to what is missing, with a time of its own for each direction."""
    rises = at.signal > at.z[0]
    return (at.signal - at.z[0]) / ca.fmax(ca.if_else(rises, at.p["filling"], at.p["exhausting"]), 2 * at.step)


def _lag(at: At) -> tuple[ca.SX, list[ca.SX]]:
    return follow(at, _asked(at), ca.fmax(at.p["filling"], at.p["exhausting"]))


def _choked(at: At) -> tuple[ca.SX, list[ca.SX]]:
    """As fast as the steps resolve, but no faster than the highest flow of each direction."""
    size, shortest = at.sizes["signal"], 2 * at.step
    most, least = (size / ca.fmax(at.p[name], 1e-3 * shortest) for name in ("filling", "exhausting"))
    rate = ca.fmin(ca.fmax((at.signal - at.z[0]) / shortest, -least), most)
    return follow(at, rate, ca.fmax(at.p["filling"], at.p["exhausting"]))


def _choked_lag(at: At) -> tuple[ca.SX, list[ca.SX]]:
    most = at.sizes["signal"] / ca.fmax(at.p["choke"], 1e-3 * at.step)
    return follow(at, ca.fmin(ca.fmax(_asked(at), -most), most), ca.fmax(at.p["filling"], at.p["exhausting"]))


def _growing(at: At) -> tuple[ca.SX, list[ca.SX]]:
    """The time grows with the volume: that of the tubes, which is there without pressure, and that of a chamber that gives way."""
    time = at.p["time"] * ca.fmax(1 + at.p["growth"] * at.z[0] / at.sizes["signal"], 0.1)
    return follow(at, (at.signal - at.z[0]) / ca.fmax(time, 2 * at.step), at.p["time"])


def _leak(at: At) -> tuple[ca.SX, list[ca.SX]]:
    """The flow through a hole, and what the regulator falls short for it, grows with the root of the pressure."""
    size = at.sizes["signal"]
    return at.signal - at.p["loss"] * ca.sqrt(size) * ca.sqrt(ca.fmax(at.signal, 1e-6 * size)), []


PNEUMATICS = (
    Law(
        "pressure_lag", "input", (_time("filling"), _time("exhausting")), _lag, states=1, smooth=False, family=LAG,
        explains="the pressure follows its command with a lag: one time to fill, another to exhaust",
    ),
    Law(
        "choked_flow", "input", (_time("filling", CHOKES), _time("exhausting", CHOKES)), _choked, states=1, smooth=False, family=LAG,
        explains="the pressure changes no faster than flow at the speed of sound fills and exhausts; times of a change by its usual size",
        reference="ISO 6358",
    ),
    Law(
        "choked_lag", "input", (_time("filling"), _time("exhausting"), Quantity("choke", "time", 0.0, CHOKES, 0.0, 30.0)), _choked_lag,
        states=1, smooth=False, family=LAG, reference="ISO 6358",
        explains="the pressure follows its command with a lag, and no faster than flow at the speed of sound allows",
    ),
    Law(
        "volume_lag", "input", (_time("time"), Quantity("growth", "1", 0.0, (-0.5, 0.0, 1.0), -0.9, 10.0, shape=True)), _growing, states=1,
        smooth=False, family=LAG,
        explains="the pressure follows its command with a lag that grows with the chamber's volume, from that of the tubes on",
    ),
    Law(
        "leak", "input", (Quantity("loss", "1", 0.0, (0.01, 0.1), 0.0, 1.0),), _leak,
        explains="pressure is lost through a hole, in proportion to the flow through it", reference="Torricelli 1643",
    ),
    *(law for law in INPUT if law.name in {"input_gain", "input_offset", "input_dead_zone"}),
)  # fmt: skip
"""Effects between a commanded pressure and the chamber: for inputs that are pressures, in the place of `signals.INPUT`."""

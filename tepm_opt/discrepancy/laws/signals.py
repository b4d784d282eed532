"""Laws of signals on their way in and out: dead times, lags, gains, offsets, dead zones, limits."""

from __future__ import annotations

import casadi as ca

from tepm_opt.discrepancy.laws.effect import At, Law, Quantity

TIMES = (0.01, 0.1, 1.0)  # of the machine's own time
DELAYS = (0.1, 0.5, 2.0)  # of it; near enough to each other for a fit to find what lies between
PARTS = (0.01, 0.1)
LIMITS = tuple(1.6**k for k in range(-3, 5))  # so close that one lies just below whatever the signal reaches


def follow(at: At, rate: ca.SX, time: ca.SX) -> tuple[ca.SX, list[ca.SX]]:
    """What follows a signal at a rate; the signal itself where the time that it takes is too short for the steps to resolve."""
    return ca.if_else(time < 2 * at.step, at.signal, at.z[0]), [rate]


def _lagged(at: At, time: ca.SX) -> tuple[ca.SX, list[ca.SX]]:
    """First order."""
    return follow(at, (at.signal - at.z[0]) / ca.fmax(time, 2 * at.step), time)


def _time(name: str) -> Quantity:
    return Quantity(name, "time", 0.0, TIMES, 0.0, 30.0)


def _late(at: At) -> tuple[ca.SX, list[ca.SX]]:
    """The command as it was; the present one where the past is not known."""
    return at.signal if at.earlier is None else at.earlier(at.p["delay"]), []


def _dead(at: At) -> tuple[ca.SX, list[ca.SX]]:
    width = at.p["width"]
    return at.signal - ca.fmin(ca.fmax(at.signal, -width), width), []


def _limited(at: At) -> tuple[ca.SX, list[ca.SX]]:
    """Nothing above a highest value, of which the parameter is the reciprocal: 0 leaves the signal alone."""
    highest = at.sizes["signal"] / ca.fmax(at.p["tightness"], 1e-9)
    return ca.fmin(at.signal, highest), []


def _held(at: At) -> tuple[ca.SX, list[ca.SX]]:
    """Nothing above a highest size, either way."""
    highest = at.sizes["signal"] / ca.fmax(at.p["tightness"], 1e-9)
    return ca.fmax(ca.fmin(at.signal, highest), -highest), []


def _played(at: At) -> tuple[ca.SX, list[ca.SX]]:
    """What a signal drags along once the play is used up; the state follows within two time steps."""
    (z,), width = at.z, at.p["width"]
    dragged = at.signal - ca.fmin(ca.fmax(at.signal - z, -width), width)
    return dragged, [(dragged - z) / (2 * at.step)]


def _swings(at: At) -> tuple[ca.SX, list[ca.SX]]:
    """Second order; the signal itself where the swing is too short for the steps to resolve."""
    (z, rate), time = at.z, ca.fmax(at.p["time"], 2 * at.step)
    turning = ((at.signal - z) / time - 2 * at.p["damping"] * rate) / time
    return ca.if_else(at.p["time"] < 2 * at.step, at.signal, z), [rate, turning]


INPUT = (
    Law(
        "time_delay", "input", (Quantity("delay", "time", 0.0, DELAYS, 0.0, 30.0),), _late, smooth=False, delays=True,
        explains="the command acts after a dead time, unchanged",
        reference="pure transport delay; Åström and Murray, Feedback Systems, 2nd ed., section 9.2",
    ),
    Law(
        "input_lag", "input", (_time("time"),), lambda at: _lagged(at, at.p["time"]), states=1, smooth=False,
        explains="what acts follows the command like a first-order lag",
    ),
    Law(
        "unequal_lag", "input", (_time("filling"), _time("exhausting")),
        lambda at: _lagged(at, ca.if_else(at.signal > at.z[0], at.p["filling"], at.p["exhausting"])), states=1, smooth=False,
        explains="what acts follows the command like a lag, with another time when it rises than when it falls",
    ),
    Law(
        "input_gain", "input", (Quantity("loss", "1", 0.0, PARTS, -1.0, 1.0),), lambda at: ((1 - at.p["loss"]) * at.signal, []),
        explains="the command acts with another gain", gauge=True,
    ),
    Law(
        "input_offset", "input", (Quantity("offset", "signal", 0.0, PARTS, -1.0, 1.0),), lambda at: (at.signal + at.p["offset"], []),
        explains="the command's zero is off", gauge=True,
    ),
    Law(
        "input_dead_zone", "input", (Quantity("width", "signal", 0.0, (0.01, 0.1), 0.0, 1.0),), _dead, smooth=False,
        explains="small commands do nothing",
    ),
)  # fmt: skip
"""Effects on what goes in."""

DRIVE = (
    Law(
        "input_saturation", "input", (Quantity("tightness", "1", 0.0, LIMITS, 0.0, 100.0),), _held, smooth=False,
        explains="what acts has a largest size, either way",
    ),
    Law(
        "backlash", "input", (Quantity("width", "signal", 0.0, (0.01, 0.1), 0.0, 1.0),), _played, states=1, smooth=False,
        explains="what acts follows the command only once a play is used up", reference="play operator; Krasnosel'skii, Pokrovskii 1989",
    ),
    Law(
        "compliance", "input", (_time("time"), Quantity("damping", "1", 0.2, (0.05, 0.5), 0.0, 2.0, shape=True)), _swings, states=2,
        smooth=False, explains="something elastic between command and what acts: it overshoots and swings",
    ),
)  # fmt: skip
"""Effects on what drives go in with, for whoever has reason to look for them: no part of `INPUT`."""

OUTPUT = (
    Law(
        "sensor_lag", "output", (_time("time"),), lambda at: _lagged(at, at.p["time"]), states=1, smooth=False,
        explains="the sensor follows like a first-order lag",
    ),
    Law(
        "sensor_gain", "output", (Quantity("gain", "1", 0.0, PARTS, -1.0, 1.0),), lambda at: ((1 + at.p["gain"]) * at.signal, []),
        explains="the sensor's gain is off",
    ),
    Law(
        "sensor_offset", "output", (Quantity("offset", "signal", 0.0, PARTS, -1.0, 1.0),), lambda at: (at.signal + at.p["offset"], []),
        explains="the sensor's zero is off",
    ),
    Law(
        "sensor_saturation", "output", (Quantity("tightness", "1", 0.0, LIMITS, 0.0, 10.0),), _limited, smooth=False,
        explains="the sensor, or what it looks at, cannot show more than so much",
    ),
)  # fmt: skip
"""Effects on what is measured."""

"""Laws of signals on their way in and out: dead times, lags, gains, offsets, dead zones, limits."""

from __future__ import annotations

import casadi as ca

from tepm_opt.discrepancy.laws.effect import At, Law, Quantity


def time_constant(name: str, probes: tuple[float, ...] = (0.01, 0.1, 1.0), shape: bool = False) -> Quantity:
    """A time in parts of the machine's own, 0 where it has no influence; by default decades are tried."""
    return Quantity(name, "time", 0.0, probes, 0.0, 30.0, shape)


def _fraction(name: str, size: str = "1") -> Quantity:
    return Quantity(name, size, 0.0, (0.01, 0.1), -1.0, 1.0)


def _width() -> Quantity:
    return Quantity("width", "signal", 0.0, (0.01, 0.1), 0.0, 1.0)


def _tightness(high: float) -> Quantity:
    """Reciprocal of a highest value; the probes are so close that one lies just below whatever the signal reaches."""
    return Quantity("tightness", "1", 0.0, tuple(1.6**k for k in range(-3, 5)), 0.0, high)


def follow(at: At, rate: ca.SX, time: ca.SX) -> tuple[ca.SX, list[ca.SX]]:
    """A state that follows a signal at a rate; the signal itself where that takes less time than two steps."""
    return ca.if_else(time < 2 * at.step, at.signal, at.z[0]), [rate]


def _lag(at: At, time: ca.SX) -> tuple[ca.SX, list[ca.SX]]:
    """Follow the signal with a first-order lag."""
    return follow(at, (at.signal - at.z[0]) / ca.fmax(time, 2 * at.step), time)


def _delay(at: At) -> tuple[ca.SX, list[ca.SX]]:
    """The command after a dead time; the present one where the past is not known."""
    return at.signal if at.earlier is None else at.earlier(at.p["delay"]), []


def _pass_beyond_width(at: At) -> tuple[ca.SX, list[ca.SX]]:
    width = at.p["width"]
    return at.signal - ca.fmin(ca.fmax(at.signal, -width), width), []


def _highest(at: At) -> ca.SX:
    """Highest value of a signal, of which the parameter is the reciprocal: 0 leaves the signal alone."""
    return at.sizes["signal"] / ca.fmax(at.p["tightness"], 1e-9)


def _limit_above(at: At) -> tuple[ca.SX, list[ca.SX]]:
    return ca.fmin(at.signal, _highest(at)), []


def _limit_both_ways(at: At) -> tuple[ca.SX, list[ca.SX]]:
    return ca.fmax(ca.fmin(at.signal, _highest(at)), -_highest(at)), []


def _drag(at: At) -> tuple[ca.SX, list[ca.SX]]:
    """The signal behind a play, moved once the play is used up; the state follows within two time steps."""
    (z,), width = at.z, at.p["width"]
    dragged = at.signal - ca.fmin(ca.fmax(at.signal - z, -width), width)
    return dragged, [(dragged - z) / (2 * at.step)]


def _follow_second_order(at: At) -> tuple[ca.SX, list[ca.SX]]:
    """Follow the signal with a second-order lag; the signal itself where that is too short for the steps to resolve."""
    (z, rate), time = at.z, ca.fmax(at.p["time"], 2 * at.step)
    turning = ((at.signal - z) / time - 2 * at.p["damping"] * rate) / time
    return ca.if_else(at.p["time"] < 2 * at.step, at.signal, z), [rate, turning]


INPUT = (
    Law(
        "time_delay", "input", (time_constant("delay", (0.1, 0.5, 2.0)),), _delay, smooth=False, delays=True,
        explains="the command acts after a dead time, unchanged",
        reference="pure transport delay; Åström and Murray, Feedback Systems, 2nd ed., section 9.2",
    ),
    Law(
        "input_lag", "input", (time_constant("time"),), lambda at: _lag(at, at.p["time"]), states=1, smooth=False,
        explains="what acts follows the command like a first-order lag",
    ),
    Law(
        "unequal_lag", "input", (time_constant("filling"), time_constant("exhausting")),
        lambda at: _lag(at, ca.if_else(at.signal > at.z[0], at.p["filling"], at.p["exhausting"])), states=1, smooth=False,
        explains="what acts follows the command like a lag, with another time when it rises than when it falls",
    ),
    Law(
        "input_gain", "input", (_fraction("loss"),), lambda at: ((1 - at.p["loss"]) * at.signal, []),
        explains="the command acts with another gain", gauge=True,
    ),
    Law(
        "input_offset", "input", (_fraction("offset", "signal"),), lambda at: (at.signal + at.p["offset"], []),
        explains="the command's zero is off", gauge=True,
    ),
    Law(
        "input_dead_zone", "input", (_width(),), _pass_beyond_width, smooth=False,
        explains="small commands do nothing",
    ),
)  # fmt: skip
"""Effects on inputs. Probes of the dead time are near enough to each other for a fit to find any delay between them."""

DRIVE = (
    Law(
        "input_saturation", "input", (_tightness(100.0),), _limit_both_ways, smooth=False,
        explains="what acts has a largest size, either way",
    ),
    Law(
        "backlash", "input", (_width(),), _drag, states=1, smooth=False,
        explains="what acts follows the command only once a play is used up", reference="play operator; Krasnosel'skii, Pokrovskii 1989",
    ),
    Law(
        "compliance", "input", (time_constant("time"), Quantity("damping", "1", 0.2, (0.05, 0.5), 0.0, 2.0, shape=True)),
        _follow_second_order, states=2, smooth=False,
        explains="something elastic between command and what acts: it overshoots and swings",
    ),
)  # fmt: skip
"""Effects of drives on inputs, for machines with reason to look for them: no part of `INPUT`."""

OUTPUT = (
    Law(
        "sensor_lag", "output", (time_constant("time"),), lambda at: _lag(at, at.p["time"]), states=1, smooth=False,
        explains="the sensor follows like a first-order lag",
    ),
    Law(
        "sensor_gain", "output", (_fraction("gain"),), lambda at: ((1 + at.p["gain"]) * at.signal, []),
        explains="the sensor's gain is off",
    ),
    Law(
        "sensor_offset", "output", (_fraction("offset", "signal"),), lambda at: (at.signal + at.p["offset"], []),
        explains="the sensor's zero is off",
    ),
    Law(
        "sensor_saturation", "output", (_tightness(10.0),), _limit_above, smooth=False,
        explains="the sensor, or what it looks at, cannot show more than so much",
    ),
)  # fmt: skip
"""Effects on outputs."""

"""Slips that change nothing that anybody could notice, each with the reason. A draw leaves them out."""

from __future__ import annotations

from tests.hw.spoil.operators import changes
from tests.hw.spoil.spoiling import BOARD, FIRMWARE, StaleError, source

EQUIVALENT = {
    (
        "tepm_opt/hw/guard.py",
        "if TYPE_CHECKING:",
        "if (not (TYPE_CHECKING)):",
    ): "The import is for the types alone; that it is made only costs time.",
    (
        f"{FIRMWARE}/tepm.cpp",
        "link::receive(); motors::alive();",
        "motors::alive(); link::receive();",
    ): "Receiving gives a sign of life after each byte itself.",
    (
        f"{BOARD}/rig.py",
        "self.link.wait(lambda: self._clock() >= self._last + self._patience, self._last + self._patience - self._clock())",
        "self.link.wait(lambda: self._clock() > self._last + self._patience, self._last + self._patience - self._clock())",
    ): "At that very moment the wait's own time is over, too.",
    (
        f"{FIRMWARE}/board.cpp",
        "const uint8_t ms = since < 255 ? since : 255;",
        "const uint8_t ms = since < 510 ? since : 255;",
    ): "A pass that is later than 120 ms never comes: the watchdog bites.",
    (
        f"{FIRMWARE}/board.cpp",
        "while (k < DACS && !disagrees(k) && adc::monitor(k) >= LIMITS.monitor_low && adc::monitor(k) <= LIMITS.monitor_trip) ++k;",
        "while (k < DACS && !disagrees(k) && adc::monitor(k) >= LIMITS.monitor_low && adc::monitor(k) < LIMITS.monitor_trip) ++k;",
    ): "One count, 0.03 kPa, at the trip itself; half a second after ARMED, with all set points at zero, it disagrees anyway.",
    (
        f"{FIRMWARE}/motors.cpp",
        "if (rising & 1 << motor) position_[motor] = 0; if (!(bits & 1 << motor)) speed[motor] = fraction[motor] = 0;",
        "if (!(bits & 1 << motor)) speed[motor] = fraction[motor] = 0; if (rising & 1 << motor) position_[motor] = 0;",
    ): "They set different variables, and neither reads what the other sets.",
    (
        f"{FIRMWARE}/memory.cpp",
        "if ((start.number ^ start.inverse) != 0xFFFF || (found && (int16_t)(start.number - last.number) < 0)) continue;",
        "if ((start.number ^ start.inverse) != 0xFFFF || (found && (int16_t)(start.number - last.number) <= 0)) continue;",
    ): "No two places hold the same number: each start writes one more than the largest.",
    (
        f"{FIRMWARE}/board.cpp",
        "motors::begin(); if (was_armed) fail(Fault::RESET_WHILE_ARMED);",
        "if (was_armed) fail(Fault::RESET_WHILE_ARMED); motors::begin();",
    ): "The fault switches off motors that are off: until they are told otherwise their pins are inputs, pulled up outside.",
    (
        f"{FIRMWARE}/board.cpp",
        "if (state_ != State::IDLE) return Result::WRONG_STATE; if (dac::hung()) return Result::BUS;",
        "if (dac::hung()) return Result::BUS; if (state_ != State::IDLE) return Result::WRONG_STATE;",
    ): "With MCP4922 nothing ever hangs; with MCP4728 ARM is refused in either order.",
    (
        f"{FIRMWARE}/motors.cpp",
        "if (bits == 0) continue; for (uint8_t left = count; left; --left) steps[pgm_read_byte(when++)] |= bits;",
        "for (uint8_t left = count; left; --left) steps[pgm_read_byte(when++)] |= bits; if (bits == 0) continue;",
    ): "Without bits the loop changes nothing; leaving it out saves some of a pass that has time left.",
    (
        f"{FIRMWARE}/board.cpp",
        "for (uint8_t k = 0; k < DACS; ++k) over[k].value = broken[k].value = stuck[k].value = 0;",
        "for (uint8_t k = 0; k < DACS; ++k) over[k].value = broken[k].value = stuck[k].value = 1;",
    ): "A counter rises by 24 every 6 ms, to 200, or by 6, to 1500: from 1 on it gets there in the same pass as from 0.",
    (
        f"{FIRMWARE}/motors.cpp",
        "const bool ahead = distance > 0, forwards = speed[motor] > 0;",
        "const bool ahead = distance > 0, forwards = speed[motor] >= 0;",
    ): "A motor that stands is in either case started anew: its direction counts from STEP_START_HZ on.",
    (
        f"{FIRMWARE}/config.h",
        "constexpr uint8_t STEPS_MAX = TICKS / 2; // in a pass: every second tick",
        "constexpr uint8_t STEPS_MAX = TICKS * 2; // in a pass: every second tick",
    ): "The largest rate, 9.524 steps a pass and a fraction that is left over, never asks for more than 10.",
    (
        f"{FIRMWARE}/link.cpp",
        "board::report(payload.hello); begin_payload(sizeof payload.hello);",
        "begin_payload(sizeof payload.hello); board::report(payload.hello);",
    ): "The one writes the payload, the other how long it is and where its sum begins.",
}
"""By file, line before and line after."""


def check_equivalent() -> None:
    """Look whether each can still be drawn.

    Raises:
        StaleError: the source has changed; names the entry.
    """
    for file in sorted({file for file, _, _ in EQUIVALENT}):
        text = source(file)
        known = {spoiling.lines(text) for spoiling in changes(file, text)}
        for entry in EQUIVALENT:
            if entry[0] == file and entry[1:] not in known:
                raise StaleError(f"equivalent.py: {file} has no such change any more: {entry[1]!r} to {entry[2]!r}")

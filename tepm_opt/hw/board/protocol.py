"""Messages between host and board: the one description of the protocol. `firmware/protocol.h` is written from it.

A frame on the line is COBS(payload + CRC) and a zero byte (Cheshire and Baker 1999). The CRC is CRC-16/GENIBUS of the payload, high byte
first: it begins with ones and is sent inverted, so that zeros before or after a frame damage it. A payload is a code and the fields of
that message, little-endian, always of the same length.

A session is what happens between two changes of mind: it has another number after each start of the board, ARM, stop and CLEAR, and none
comes twice (`firmware/memory.cpp`). ARM, CLEAR, CONFIG and SET carry it, and SET a sequence number, which only grows: a frame that was
recorded, repeated or held up does nothing.
"""

from __future__ import annotations

import binascii
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any

from cobs import cobs

VERSION = 2
CHANNELS = 6
"""Actuators that a board can have: the arrays of all messages have this length."""
DAC_CODES = 4096
POSITION_MODE = 0x80
"""Bit of the field `enabled` of SET: tendon set points are steps, not counts of the dynamometers."""


Values = dict[str, Any]
"""Content of a message: numbers and tuples of numbers by the field's name."""


class State(IntEnum):
    """State of the board. Only ARMED moves anything."""

    IDLE = 0
    ARMED = 1
    HOST_TIMEOUT = 2
    ESTOP = 3
    FAULT = 4


class Fault(IntEnum):
    """Fault that the board found; a graver one has a greater number. All that were found are kept as bits, and the gravest decides.

    From MONITOR on pressure cannot be trusted to follow: the board switches its outputs off, which vents everything.
    """

    NONE = 0
    RESET_WHILE_ARMED = 1
    TRAVEL = 2
    DYNAMOMETER = 3
    TENSION_TOO_HIGH = 4
    MONITOR = 5
    REGULATOR = 6
    PRESSURE_TOO_HIGH = 7
    BUS = 8
    LOOP_HUNG = 9

    @property
    def bit(self) -> int:
        """Its place in the field `faults` of STATUS; 0 for NONE."""
        return 1 << self >> 1


class Result(IntEnum):
    """Answer to a request."""

    DONE = 0
    WRONG_STATE = 1
    WRONG_SESSION = 2
    ESTOP_PRESSED = 3
    DYNAMOMETER = 4
    UNKNOWN_KEY = 5
    OUT_OF_RANGE = 6
    MONITOR = 7
    WRONG_LIMITS = 8
    BUS = 9


class Key(IntEnum):
    """Settings of CONFIG; a board forgets them when it is reset."""

    STATUS_PERIOD_MS = 1
    PRESSURE_SLEW = 2
    STEP_RATE = 3
    STEPS_PER_1000_COUNTS = 4


class ResetCause(IntEnum):
    """Bits of the processor's own register; a boot loader may have cleared them."""

    POWER_ON = 1
    RESET_PIN = 2
    BROWN_OUT = 4
    WATCHDOG = 8


@dataclass(frozen=True)
class Message:
    """A kind of message.

    Attributes:
        name: as in the firmware.
        code: first byte.
        fields: names with `struct` codes; a number before the code makes an array.
    """

    name: str
    code: int
    fields: tuple[tuple[str, str], ...]

    @cached_property
    def layout(self) -> struct.Struct:
        """Format of the payload."""
        return struct.Struct("<B" + "".join(kind for _, kind in self.fields))

    def pack(self, **values: int | list[int] | tuple[int, ...]) -> bytes:
        """The payload.

        Raises:
            struct.error, KeyError: a value does not fit, or is missing.
        """
        flat: list[int] = []
        for name, _ in self.fields:
            value = values[name]
            flat.extend(value) if isinstance(value, list | tuple) else flat.append(value)
        return self.layout.pack(self.code, *flat)

    def unpack(self, payload: bytes) -> Values:
        """Values by name; arrays as tuples."""
        flat = self.layout.unpack(payload)[1:]
        values: Values = {}
        at = 0
        for name, kind in self.fields:
            count = int(kind[:-1] or 0)
            values[name] = flat[at : at + count] if count else flat[at]
            at += count or 1
        return values


_N = CHANNELS
SET = Message("SET", 0x01, (("session", "I"), ("sequence", "I"), ("enabled", "B"), ("pressures", f"{_N}H"), ("tendons", f"{_N}h")))
ARM = Message("ARM", 0x02, (("id", "B"), ("session", "I"), ("limits", "H")))
CLEAR = Message("CLEAR", 0x03, (("id", "B"), ("session", "I")))
ESTOP = Message("ESTOP", 0x04, (("id", "B"),))
CONFIG = Message("CONFIG", 0x05, (("id", "B"), ("session", "I"), ("key", "B"), ("value", "H")))
ASK = Message("ASK", 0x06, (("id", "B"),))
DISARM = Message("DISARM", 0x07, (("id", "B"),))
STATUS = Message(
    "STATUS",
    0x81,
    (
        ("sequence", "H"),  # the low half of the last set point's
        ("count", "B"),
        ("session", "I"),
        ("state", "B"),
        ("faults", "H"),
        ("fault", "B"),
        ("channel", "B"),
        ("enabled", "B"),
        ("good", "H"),
        ("bad", "H"),
        ("refused", "B"),
        ("stale", "B"),
        ("late", "B"),
        ("time_ms", "I"),
        ("dynamometers", f"{_N}H"),
        ("monitors", f"{_N}H"),
        ("positions", f"{_N}h"),
    ),
)
ACK = Message("ACK", 0x82, (("id", "B"), ("request", "B"), ("result", "B"), ("channel", "B"), ("state", "B"), ("session", "I")))
HELLO = Message(
    "HELLO",
    0x83,
    (
        ("version", "B"),
        ("channels", "B"),
        ("monitors", "B"),
        ("reset_cause", "B"),
        ("state", "B"),
        ("session", "I"),
        ("build", "I"),
        ("limits", "H"),
        ("timeout_ms", "B"),
    ),
)
LIMITS = Message(
    "LIMITS",
    0x84,
    (
        ("code_zero", "h"),
        ("codes_per_MPa", "H"),
        ("pressure_max", "H"),
        ("monitor_zero", "H"),
        ("monitor_per_code", "H"),
        ("monitor_low", "H"),
        ("monitor_trip", "H"),
        ("regulator_band", "H"),
        ("tension_zero", "H"),
        ("tension_max", "H"),
        ("tension_trip", "H"),
        ("dynamometer_low", "H"),
        ("position_max", "H"),
        ("steps_per_1000_counts", "H"),
    ),
)
"""Limits that the firmware was compiled with, in its own units; `limits.py` says what they mean. Its CRC stands in HELLO and ARM."""
TO_BOARD = (SET, ARM, CLEAR, ESTOP, CONFIG, ASK, DISARM)
TO_HOST = (STATUS, ACK, HELLO, LIMITS)
REQUESTS = (ARM, CLEAR, ESTOP, CONFIG, ASK, DISARM)


def crc(payload: bytes) -> int:
    """CRC-16/GENIBUS."""
    return binascii.crc_hqx(payload, 0xFFFF) ^ 0xFFFF


def frame(payload: bytes) -> bytes:
    """A payload as it goes over the line, with the zero that ends it."""
    return cobs.encode(payload + crc(payload).to_bytes(2, "big")) + b"\0"


class Decoder:
    """Messages out of a stream of bytes that may be damaged anywhere.

    Args:
        messages: the kinds that may come.

    Attributes:
        good, bad: frames with and without a message in them.
    """

    longest = 254

    def __init__(self, messages: tuple[Message, ...]) -> None:
        self.by_code: Mapping[int, Message] = {message.code: message for message in messages}
        self.good, self.bad = 0, 0
        self._rest = b""

    def feed(self, data: bytes) -> list[tuple[Message, Values]]:
        """Take bytes; return the messages that they complete, in order."""
        *whole, self._rest = (self._rest + data).split(b"\0")
        self._rest = self._rest[-self.longest - 1 :]
        found = [self._message(encoded) for encoded in whole if encoded]
        self.good += sum(message is not None for message in found)
        self.bad += sum(message is None for message in found)
        return [message for message in found if message is not None]

    def _message(self, encoded: bytes) -> tuple[Message, Values] | None:
        try:
            content = cobs.decode(encoded)
        except cobs.DecodeError:
            return None
        payload = content[:-2]
        kind = self.by_code.get(payload[0]) if payload else None
        if kind is None or len(payload) != kind.layout.size or crc(payload) != int.from_bytes(content[-2:], "big"):
            return None
        return kind, kind.unpack(payload)


_C_TYPES = {"B": "uint8_t", "H": "uint16_t", "h": "int16_t", "I": "uint32_t"}


def header() -> str:
    """The protocol as the firmware's C++ header."""
    lines = [
        "// Written by `python -m tepm_opt.hw.board.protocol`; do not edit.",
        "#pragma once",
        "#include <stdint.h>",
        "",
        "namespace protocol {",
        "",
        f"constexpr uint8_t VERSION = {VERSION};",
        f"constexpr uint8_t CHANNELS = {CHANNELS};",
        f"constexpr uint8_t POSITION_MODE = {POSITION_MODE:#04x};",
        "",
    ]
    for enum in (State, Fault, Result, Key, ResetCause):
        lines += [f"enum class {enum.__name__} : uint8_t {{", *(f"  {entry.name} = {entry.value}," for entry in enum), "};", ""]
    for message in (*TO_BOARD, *TO_HOST):
        lines += [f"struct {message.name.capitalize()} {{", f"  static constexpr uint8_t CODE = {message.code:#04x};", "  uint8_t code;"]
        for name, kind in message.fields:
            lines.append(f"  {_C_TYPES[kind[-1]]} {name}{f'[{kind[:-1]}]' if len(kind) > 1 else ''};")
        lines += ["} __attribute__((packed));", f'static_assert(sizeof({message.name.capitalize()}) == {message.layout.size}, "");', ""]
    return "\n".join([*lines, "}  // namespace protocol", ""])


if __name__ == "__main__":
    print(header(), end="")

"""A line on which no board of ours answers: what came instead, and what a person should look at, first things first."""

from __future__ import annotations

import re
from enum import Enum

KEPT = 4000
"""Bytes of what came that are kept."""
SHOWN = 48
"""Characters of a line that are shown."""
TEXT = 0.9
"""Share of printable bytes from which on what comes is text; noise at a wrong rate has 0.4."""
FEWEST = 4
"""Bytes from which on anything can be said."""
TELLING = re.compile(r"marlin|grbl|klipper|smoothie|reprap|arduino|micropython|circuitpython|firmware|login:", re.IGNORECASE)
"""Names in a line by which people know a firmware."""
PORTS = "is it the right port? `tepm hw ports` lists what there is"


class Answer(Enum):
    """Kinds of text that come over a line instead of an answer."""

    NOTHING = "nothing"
    ZEROS = "zeros"
    TEXT = "text"
    NOISE = "noise"


class Overheard:
    """Bytes that come over a line until a board answers: the first few thousand."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self._count = 0

    def __repr__(self) -> str:
        return f"Overheard({self._count} bytes, {self.answer.value})"

    def take(self, data: bytes) -> None:
        """Note bytes."""
        self._count += len(data)
        self._bytes += data[: KEPT - len(self._bytes)]

    @property
    def answer(self) -> Answer:
        """Kind of the text that came."""
        some = bytes(self._bytes).replace(b"\0", b"")
        if not self._bytes:
            return Answer.NOTHING
        if len(some) < FEWEST:
            return Answer.ZEROS if len(self._bytes) >= 4 * FEWEST else Answer.NOISE
        printable = sum(byte in b"\t\r\n" or 32 <= byte < 127 for byte in some)
        return Answer.TEXT if printable >= TEXT * len(some) else Answer.NOISE

    @property
    def line(self) -> str:
        """The line of text by which a person knows what sends it; the first whole one where none has a name in it."""
        text = bytes(self._bytes).replace(b"\0", b"").decode("ascii", errors="replace")
        lines = [each.strip() for each in re.split(r"[\r\n]+", text)]
        whole = [each for each in lines[1:-1] if each] or [each for each in lines if each]
        found = next((each for each in lines if TELLING.search(each)), whole[0] if whole else "")
        return found if len(found) <= SHOWN else f"{found[:SHOWN]}…"

    def describe(self, seconds: float) -> str:
        """Begin of a sentence about what came within so many seconds."""
        return {
            Answer.NOTHING: f"nothing answers in {seconds:g} s",
            Answer.ZEROS: f"no answer in {seconds:g} s, only zeros come",
            Answer.TEXT: f"text comes: {self.line!r}; another firmware is on this port",
            Answer.NOISE: f"no answer in {seconds:g} s, {self._count} bytes came that are no message",
        }[self.answer]

    def advise(self, flash: str) -> str:
        """Advice on what to look at, first things first.

        Args:
            flash: how to put the firmware on a board, which comes last, and not at all where another firmware talks.
        """
        return {
            Answer.NOTHING: f"in this order: {PORTS}; does the cable carry data? has the board power? Only if all is well: {flash}",
            Answer.ZEROS: f"{PORTS}; a board that restarts again and again has a weak supply or a loose cable",
            Answer.TEXT: f"{PORTS}; leave that device as it is",
            Answer.NOISE: f"{PORTS}; is the baud rate the board's own (PORT@BAUD)? Only if both are right: {flash}",
        }[self.answer]

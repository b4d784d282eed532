"""What answers on a port where no board of ours is: it is shown, and nothing is flashed before it was looked at."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tepm_opt.hw.board.errors import NoBoardError
from tepm_opt.hw.board.link import Link
from tepm_opt.hw.board.ports import SerialPort
from tepm_opt.hw.board.strangers import KEPT, Answer, Overheard
from tepm_opt.hw.service.line import Line
from tepm_opt.hw.service.monitor import BOOTING, Monitor
from tests.paths import SHARED

ASCII = SHARED / "cases" / "19-foreign-firmware" / "ascii_arduino.py"
MARLIN = b"start\necho:Marlin bugfix-2.1.x\nok T:21.3 /0.0\n"
words = st.text(st.characters(min_codepoint=32, max_codepoint=126), min_size=4, max_size=60).filter(lambda text: text.strip())


def heard(*pieces: bytes) -> Overheard:
    found = Overheard()
    for piece in pieces:
        found.take(piece)
    return found


def said(*pieces: bytes) -> str:
    return str(NoBoardError(heard(*pieces), 5.0))


def test_silence_names_the_steps_in_their_order() -> None:
    text = said()
    assert text.startswith("nothing answers in 5 s; ")
    steps = ["right port", "cable", "power", "flash"]
    assert sorted(steps, key=text.index) == steps


@pytest.mark.parametrize("name", [b"Marlin 2.1.2", b"Grbl 1.1h ['$' for help]", b"Klipper", b"MicroPython v1.22"])
def test_a_firmware_that_people_know_is_named(name: bytes) -> None:
    text = said(b"3 4 5\r\n6 7", b" 8\r\n" + name + b"\r\n9 10 11\r\n")
    assert name.decode() in text or repr(name.decode())[1:-1] in text
    assert "flash" not in text
    assert "is it the right port?" in text


@given(st.lists(words, min_size=3, max_size=20), st.sampled_from(["\n", "\r\n"]), st.integers(1, 40))
def test_any_text_is_shown_and_never_flashed_over(lines: list[str], end: str, size: int) -> None:
    data = (end.join(lines) + end).encode("ascii")
    found = heard(*(data[k : k + size] for k in range(0, len(data), size)))
    assert found.answer is Answer.TEXT
    assert found.line.removesuffix("…") in data.decode()
    assert found.line.strip()
    assert "flash" not in found.advise("flash")


@given(st.binary(min_size=200, max_size=2 * KEPT))
def test_no_stream_of_bytes_gets_flashing_as_its_first_advice(data: bytes) -> None:
    text = str(NoBoardError(heard(data), 5.0))
    assert "right port" in text
    assert "flash" not in text or text.index("right port") < text.index("flash")


def test_zeros_and_noise() -> None:
    assert "only zeros come" in said(bytes(256), bytes(256))
    assert "supply" in said(bytes(256))
    noise = bytes(range(128, 256)) * 3
    assert "384 bytes came that are no message" in said(noise)
    assert "baud rate" in said(noise)
    assert said(noise + MARLIN).startswith("no answer"), "a little text in noise is noise"


class Talker:
    """A port on which another firmware talks, on a clock of its own."""

    def __init__(self, text: bytes) -> None:
        self.text, self.time = text, 0.0

    def clock(self) -> float:
        return self.time

    def read(self, timeout: float) -> bytes:
        self.time += max(timeout, 0.01)
        return self.text

    def write(self, data: bytes) -> None:
        pass

    def close(self) -> None:
        pass


@pytest.mark.parametrize(("text", "shown"), [(MARLIN, "text comes: 'echo:Marlin bugfix-2.1.x'"), (b"", "nothing answers in 4 s")])
def test_the_monitor_shows_what_comes(text: bytes, shown: str) -> None:
    """Once a board had time to start; nobody is told to flash first."""
    talker = Talker(text)
    for reading in Monitor(lambda: Line(talker, talker.clock, threaded=False)):
        if reading.time > 4:
            break
        assert reading.time >= BOOTING or reading.words == "no answer from the board yet"
    assert reading.words.startswith(shown)
    assert "right port" in reading.words
    assert "flash" not in reading.words or reading.words.index("power") < reading.words.index("flash")


@pytest.fixture
def port(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[str]:
    """A port on which somebody else's sketch talks."""
    if not ASCII.exists():
        pytest.skip(f"cases of {SHARED} are not on this machine")
    link = tmp_path / "port"
    process = subprocess.Popen([sys.executable, str(ASCII), str(link), request.param, "20"])
    try:
        end = time.monotonic() + 10
        while not link.exists() and time.monotonic() < end:
            time.sleep(0.02)
        yield str(link)
    finally:
        process.kill()
        process.wait()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("port", "shown"),
    [("stream", ", "), ("marlin", "Marlin"), ("grbl", "error:1"), ("reboot", "only zeros come"), ("silent", "nothing answers in 1.5 s")],
    indirect=["port"],
)
def test_other_peoples_sketches(port: str, shown: str) -> None:
    link = Link(SerialPort(port), time.monotonic)
    try:
        with pytest.raises(NoBoardError) as raised:
            link.hello(1.5)
    finally:
        link.close()
    text = str(raised.value)
    assert shown in text or (shown == "error:1" and "Grbl" in text)
    assert "right port" in text
    assert "flash" not in text or text.index("power") < text.index("flash")

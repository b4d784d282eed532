"""A serial port of this computer, on a pair of pseudo terminals and on pyserial's own loop."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator

import pytest
import serial

from tepm_opt.errors import InputError
from tepm_opt.hw.board.ports import BAUD, PortBusyError, SerialPort

pty = pytest.importorskip("pty")


class Pair:
    """A port, and the other end of its line."""

    def __init__(self) -> None:
        self.far, self.near = pty.openpty()
        self.name = os.ttyname(self.near)
        self.port = SerialPort(self.name)

    def close(self) -> None:
        """Close both ends."""
        self.port.close()
        for end in (self.far, self.near):
            if end >= 0:
                os.close(end)


@pytest.fixture
def pair() -> Iterator[Pair]:
    """A line."""
    made = Pair()
    yield made
    made.close()


def test_reading_leaves_the_settings_alone(pair, monkeypatch):
    """The baud rate is set once, when the port is opened, whatever waits are asked for."""
    settings = []
    monkeypatch.setattr(type(pair.port._serial), "_reconfigure_port", lambda *_, **__: settings.append("all"))
    monkeypatch.setattr(type(pair.port._serial), "_set_special_baudrate", lambda *_: settings.append("baud"))
    for k in range(20):
        os.write(pair.far, b"abc")
        assert pair.port.read(1.0 + 0.01 * k) == b"abc"
        assert pair.port.read(0.001 * (k % 4)) == b""
        pair.port.write(b"x")
    assert settings == []


def test_it_is_opened_at_the_rate_asked_for(monkeypatch):
    rates = []
    real = serial.serial_for_url
    monkeypatch.setattr(serial, "serial_for_url", lambda *given, **settings: rates.append(settings["baudrate"]) or real(*given, **settings))
    SerialPort("loop://").close()
    SerialPort("loop://", 115200).close()
    assert rates == [BAUD, 115200]


@pytest.mark.parametrize("wait", [0.0, 0.002, 0.02, 0.1])
def test_nothing_comes(pair, wait):
    """It waits as long as was said."""
    start = time.monotonic()
    assert pair.port.read(wait) == b""
    assert wait <= time.monotonic() - start < wait + 0.5


def test_bytes_end_the_wait(pair):
    """All that is there, as soon as there is something."""
    start = time.monotonic()
    threading.Timer(0.05, os.write, (pair.far, bytes(range(200)))).start()
    assert pair.port.read(10.0)[:1] == b"\0"
    assert time.monotonic() - start < 5.0
    os.write(pair.far, b"first")
    os.write(pair.far, b"second")
    time.sleep(0.02)
    got = pair.port.read(1.0)
    assert got.endswith(b"firstsecond")


def test_what_is_written_arrives(pair):
    pair.port.write(bytes(range(256)))
    assert os.read(pair.far, 1000) == bytes(range(256))


def test_a_loop():
    """A port that only pyserial knows."""
    port = SerialPort("loop://")
    port.write(b"hello")
    assert port.read(1.0) + port.read(0.02) == b"hello"
    assert port.read(0.01) == b""
    port.close()
    port.close()


@pytest.mark.parametrize("how", ["unplugged", "closed"])
def test_a_line_that_is_gone(pair, how):
    """Both directions raise OSError, nothing else."""
    if how == "unplugged":
        os.close(pair.far)
        pair.far = -1
    else:
        pair.port.close()
    with pytest.raises(OSError):  # noqa: PT011  (the system's own words)
        pair.port.read(0.5)
    if how == "closed":
        with pytest.raises(OSError):  # noqa: PT011
            pair.port.write(b"x")


def test_closed_while_another_thread_reads(pair):
    """Whatever pyserial makes of it, the reader sees an OSError."""

    def read(port: SerialPort, seen: list[BaseException]) -> None:
        try:
            while True:
                port.read(0.02)
        except BaseException as error:
            seen.append(error)

    for _ in range(20):
        seen: list[BaseException] = []
        reader = threading.Thread(target=read, args=(pair.port, seen))
        reader.start()
        time.sleep(0.003)
        pair.port.close()
        reader.join(5.0)
        assert [isinstance(error, OSError) for error in seen] == [True]
        pair.port = SerialPort(pair.name)


def test_a_port_in_use(pair):
    with pytest.raises(PortBusyError, match=f"{pair.name}' cannot be opened: another program has it open"):
        SerialPort(pair.name)


def test_no_such_port():
    with pytest.raises(InputError, match="there is no such port"):
        SerialPort("/dev/ttyNONE7")

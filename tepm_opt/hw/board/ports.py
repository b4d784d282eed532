"""Lines of bytes: a serial port, or whatever stands in for one. Time is the caller's."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from tepm_opt.errors import InputError

Clock = Callable[[], float]
"""Tells the time in s; `time.monotonic`, or that of a simulation."""
BAUD = 250000
_SLICE = 0.005
"""Seconds that pyserial waits at a time. This stays as it is: a new timeout would set the baud rate anew, with every read."""


class PortBusyError(InputError):
    """Another program has the port open."""


class Port(Protocol):
    """A line to a board. All methods raise `OSError` once the line is gone."""

    def read(self, timeout: float) -> bytes:
        """Read bytes that came; if none did, wait for them at most `timeout` s. A simulation lets its time pass meanwhile."""
        ...

    def write(self, data: bytes) -> None:
        """Send bytes over the line."""
        ...

    def close(self) -> None:
        """Give the line free; closing twice is fine."""
        ...


class SerialPort:
    """A serial port of this computer. Opening it resets an Arduino.

    Args:
        device: `/dev/ttyACM0`, `COM3`, or a URL that pyserial knows.
        baud: bits a second.

    Raises:
        PortBusyError: another program has it open.
        InputError: it does not exist, or may not be opened; names the ports that there are.
    """

    def __init__(self, device: str, baud: int = BAUD) -> None:
        import serial

        try:
            self._serial = serial.serial_for_url(device, baudrate=baud, timeout=_SLICE, write_timeout=0.5, exclusive=True)
        except (serial.SerialException, ValueError) as error:
            text = str(error)
            if "exclusively lock" in text or "busy" in text.lower() or (sys.platform == "win32" and "Permission" in text):
                raise PortBusyError(f"serial port {device!r} cannot be opened: another program has it open") from error
            raise InputError(f"serial port {device!r} cannot be opened: {_reason(text)}; {_describe_ports()}") from error

    def read(self, timeout: float) -> bytes:
        """Read as `Port.read` does."""
        end = time.monotonic() + timeout
        try:
            while not (waiting := self._serial.in_waiting):
                left = end - time.monotonic()
                if left <= 0:
                    return b""
                if left < _SLICE:
                    time.sleep(left)
                elif first := self._serial.read(1):
                    return first + self._serial.read(self._serial.in_waiting)
            return self._serial.read(waiting)
        except TypeError as error:  # pyserial asks the system about None if another thread closes the port meanwhile
            raise OSError("the port was closed") from error

    def write(self, data: bytes) -> None:
        """Write as `Port.write` does."""
        try:
            self._serial.write(data)
        except TypeError as error:
            raise OSError("the port was closed") from error

    def close(self) -> None:
        """Close as `Port.close` does."""
        self._serial.close()


@dataclass(frozen=True)
class FoundPort:
    """A serial port of this computer.

    Attributes:
        device: its name, for `--rig serial:DEVICE`.
        description: what the system knows about it.
        arduino: whether it looks like an Arduino Mega or Uno, or a clone with one of the usual USB chips.
    """

    device: str
    description: str
    arduino: bool


_MAKERS = {0x2341, 0x2A03, 0x1A86, 0x0403}  # Arduino (both), WCH, FTDI


def find_ports() -> list[FoundPort]:
    """The serial ports of this computer, likely boards first."""
    from serial.tools import list_ports

    found = [FoundPort(port.device, port.description or "", port.vid in _MAKERS) for port in list_ports.comports()]
    return sorted(found, key=lambda port: (not port.arduino, port.device))


def _describe_ports() -> str:
    names = [port.device for port in find_ports()]
    return f"serial ports here: {', '.join(names)}" if names else "there is no serial port here"


def _reason(text: str) -> str:
    if "Permission" in text:
        return "no permission; on Linux add yourself to the group dialout and log in anew"
    return "there is no such port" if "No such file" in text or "could not open" in text else text

"""The emulated control board: its firmware and simavr, built here and driven through ctypes."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
from functools import lru_cache
from pathlib import Path

import numpy as np

from tepm_opt.hw.board import protocol

HERE = Path(__file__).parent
FIRMWARE = Path(protocol.__file__).parent.parent / "firmware"
HZ = 16_000_000
CHANNELS = protocol.CHANNELS
POWER_ON, PIN, BROWN_OUT = 1, 2, 4
RESET, CLOCK = 1, 2


def missing() -> str:
    """What is not installed of what the emulated board needs; empty when all is there."""
    wanted = {"avr-gcc": "gcc-avr", "make": "make", "cc": "gcc"}
    lacking = [package for program, package in wanted.items() if shutil.which(program) is None]
    files = {
        "/usr/share/arduino/hardware/arduino/avr/cores/arduino/Arduino.h": "arduino-core-avr",
        "/usr/include/simavr/sim_avr.h": "libsimavr-dev",
        "/usr/lib/avr/include/avr/io.h": "avr-libc",
    }
    lacking += [package for path, package in files.items() if not Path(path).exists()]
    return f"the emulated board needs Debian's {', '.join(lacking)}" if lacking else ""


def build_firmware(
    folder: Path, board: str = "mega", options: str = "", flavour: str = "make", limits: str | Path = "limits.h", source: Path = FIRMWARE
) -> Path:
    """The ELF file of the firmware.

    Args:
        folder: for all that is built.
        board: mega or uno.
        options: for the compiler.
        flavour: whose flags: make's, the Arduino IDE's, or PlatformIO's.
        limits: header of a robot.
        source: the firmware's own folder, or another one.
    """
    settings = {"BOARD": board, "OUT": folder, "OPTIONS": options, "FLAVOUR": flavour, "LIMITS": limits}
    command = ["make", "-s", "-C", str(source), *(f"{name}={value}" for name, value in settings.items())]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr)
    return folder / "tepm.elf"


def build_emulator(folder: Path, program: bool = False) -> Path:
    """The library, or the program with a pseudo-terminal."""
    target = folder / ("emulator" if program else "emulator.so")
    form = ["-DPROGRAM"] if program else ["-shared", "-fPIC"]
    libraries = ["-lsimavr", "-lm", *(["-lutil"] if program else [])]
    subprocess.run(["cc", "-O2", *form, "-I/usr/include/simavr", "-o", str(target), str(HERE / "emulator.c"), *libraries], check=True)
    return target


PASS = np.dtype(
    [
        ("cycle", "<u8"),
        ("delivered", "<u4"),
        *((name, "u1") for name in ("kind", "enabled", "outputs", "pressed")),
        ("dynamometers", "<i2", CHANNELS),
        *((name, "<u2", CHANNELS) for name in ("monitors", "dac")),
    ],
    align=True,
)
"""What is on the pins in a pass of the main loop; see `Board.passes`."""


_PASSES = np.zeros(1 << 13, dtype=PASS)


class _Event(ctypes.Structure):
    _fields_ = (("cycle", ctypes.c_uint64), ("channel", ctypes.c_int32), ("value", ctypes.c_int32))


@lru_cache
def _symbols(firmware: Path, changed: int) -> list[str]:
    """Lines of `avr-nm`; `changed` is when the file was."""
    return subprocess.run(["avr-nm", str(firmware)], capture_output=True, text=True, check=True).stdout.splitlines()


def _load(path: Path) -> ctypes.CDLL:
    library = ctypes.CDLL(str(path))
    handle, u8, u16, u32, u64, i32 = ctypes.c_void_p, ctypes.c_uint8, ctypes.c_uint16, ctypes.c_uint32, ctypes.c_uint64, ctypes.c_int32
    signatures = {
        "new": (handle, [ctypes.c_char_p, ctypes.c_char_p, u32]),
        "free": (None, [handle]),
        "cycle": (u64, [handle]),
        "baud": (u32, [handle]),
        "run": (i32, [handle, u64]),
        "send": (u32, [handle, ctypes.c_char_p, u32]),
        "cut": (None, [handle]),
        "line": (None, [handle, u32]),
        "take": (u32, [handle, ctypes.c_char_p, u32]),
        "take_steps": (u32, [handle, ctypes.POINTER(_Event), u32]),
        "take_directions": (u32, [handle, ctypes.POINTER(_Event), u32]),
        "take_dac": (u32, [handle, ctypes.POINTER(_Event), u32]),
        "peaks": (None, [handle, ctypes.POINTER(u16)]),
        "dac": (u16, [handle, i32]),
        "position": (ctypes.c_int64, [handle, i32]),
        "steps": (u64, [handle, i32]),
        "idle_steps": (u64, [handle]),
        "enabled": (u8, [handle]),
        "outputs": (i32, [handle]),
        "follow": (None, [handle, i32]),
        "tendons": (None, [handle, i32]),
        "hold": (None, [handle, u16]),
        "take_passes": (u32, [handle, ctypes.c_void_p, u32]),
        "delivered": (u32, [handle]),
        "monitor": (None, [handle, i32, ctypes.c_double]),
        "dynamometer": (None, [handle, i32, i32]),
        "counts_per_step": (None, [handle, ctypes.c_double]),
        "estop": (None, [handle, i32]),
        "reset": (None, [handle, u8]),
        "patch": (u16, [handle, u32, u16]),
        "byte": (u8, [handle, u16]),
        "write": (None, [handle, u16, u8]),
        "pc": (u32, [handle]),
        "stop_at": (None, [handle, u32]),
        "dac_memory": (None, [handle, u16]),
        "watch": (None, [handle, u16, u32]),
        "share": (None, [handle, u16, u16]),
        "unguarded": (u64, [handle]),
        "worst_gap": (u64, [handle]),
        "idle_cycles": (u64, [handle]),
        "twi": (None, [handle, i32, u8, u8]),
        "slow": (None, [handle, ctypes.c_double]),
        "longest_loop": (u64, [handle]),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(library, f"board_{name}")
        function.restype, function.argtypes = result, arguments
    return library


class Board:
    """An emulated board, powered on at time 0; its time passes only in `run`.

    Unless told otherwise its pressure monitors show what its DACs give, and its dynamometers what its motors have wound.
    """

    def __init__(self, library: Path, firmware: Path, mcu: str = "atmega2560", seed: int = 1) -> None:
        self.firmware = firmware
        self._library = _load(library)
        self._handle = self._library.board_new(str(firmware).encode(), mcu.encode(), seed)
        if not self._handle:
            raise RuntimeError(f"{firmware} does not run on {mcu}")
        self._first_word: int | None = None
        self._run_to = 0.0
        self._start = self.cycle

    def __del__(self) -> None:
        if getattr(self, "_handle", None):
            self._library.board_free(self._handle)

    def _call(self, name: str, *arguments: object) -> int:
        return getattr(self._library, f"board_{name}")(self._handle, *arguments)

    @property
    def cycle(self) -> int:
        """Processor cycles since power-on."""
        return self._call("cycle")

    @property
    def time(self) -> float:
        """Virtual time in s: what `run` was asked for in total, without the few cycles by which instructions exceed it."""
        return self._run_to

    def run(self, duration: float) -> None:
        """Let `duration` s pass."""
        self._run_to += duration
        if self._call("run", self._start + round(self._run_to * HZ)) < 0:
            raise RuntimeError(f"the firmware crashed at {self._run_to:.6f} s")

    def run_to(self, name: str, most: float = 0.01) -> None:
        """Let time pass until the program stands at the first instruction of a function."""
        self._call("stop_at", self.symbol(name))
        if self._call("run", self.cycle + round(most * HZ)) != 1:
            raise RuntimeError(f"the firmware does not come to {name} in {most} s")
        self._call("stop_at", 0xFFFFFFFF)
        self._run_to = (self.cycle - self._start) / HZ

    def send(self, data: bytes) -> None:
        """Bytes onto the line to the board; they arrive one after the other at the line's speed."""
        if self._call("send", data, len(data)) != len(data):
            raise RuntimeError("more than a second of bytes is waiting on the line")

    def take(self) -> bytes:
        """Bytes that have come from the board by now."""
        data = ctypes.create_string_buffer(1 << 16)
        count = self._call("take", data, len(data))
        return data.raw[:count]

    def cut(self) -> None:
        """What is still on the line is lost."""
        self._call("cut")

    def line(self, bits_per_s: int) -> None:
        """Speed of the line to the board."""
        self._call("line", bits_per_s)

    @property
    def baud(self) -> int:
        """Of the board's own UART."""
        return self._call("baud")

    def _events(self, name: str) -> np.ndarray:
        """(events, 3): time in s since power-on, channel, value."""
        events = (_Event * (1 << 16))()
        count = self._call(name, events, len(events))
        raw = np.frombuffer(events, dtype=[("cycle", "<u8"), ("channel", "<i4"), ("value", "<i4")])[:count]
        return np.stack([(raw["cycle"] - self._start) / HZ, raw["channel"], raw["value"]], axis=1)

    def steps(self) -> np.ndarray:
        """Steps since the last call (the last 65,536): (steps, 3) with time in s, motor, direction."""
        return self._events("take_steps")

    def direction_changes(self) -> np.ndarray:
        """Direction lines that changed since the last call: (changes, 3) with time in s, motor, direction."""
        return self._events("take_directions")

    def dac_changes(self) -> np.ndarray:
        """What the regulators were told since the last call: (changes, 3) with time in s, channel, code."""
        return self._events("take_dac")

    def passes(self) -> np.ndarray:
        """What was on the pins in each pass of the main loop since the last call (the last 8,192), as `PASS`.

        It is noted at the edge that starts the AD7606, when the pass has done what the host asked for and begins to look at its inputs. The
        dynamometers are what the AD7606 holds then, monitors are in counts; `delivered` counts bytes that had reached the UART. Resets of
        whatever cause are noted, too (`kind` is `RESET`), and when the firmware's clock begins (`CLOCK`).
        """
        return _PASSES[: self._call("take_passes", _PASSES.ctypes.data, len(_PASSES))].copy()

    @property
    def delivered(self) -> int:
        """Bytes that have reached the UART since power-on."""
        return self._call("delivered")

    @property
    def dac(self) -> np.ndarray:
        """Codes that the regulators see now, (6,): 0 while the outputs are switched off."""
        return np.array([self._call("dac", k) for k in range(CHANNELS)])

    @property
    def dac_peak(self) -> np.ndarray:
        """The largest codes so far, (6,)."""
        codes = (ctypes.c_uint16 * CHANNELS)()
        self._library.board_peaks(self._handle, codes)
        return np.array(codes[:])

    @property
    def positions(self) -> np.ndarray:
        """Steps forwards less steps backwards while the motor was enabled, since power-on, (6,)."""
        return np.array([self._call("position", k) for k in range(CHANNELS)])

    @property
    def step_counts(self) -> np.ndarray:
        """Steps in any direction since power-on, (6,)."""
        return np.array([self._call("steps", k) for k in range(CHANNELS)])

    @property
    def idle_steps(self) -> int:
        """Steps given to motors that were not enabled."""
        return self._call("idle_steps")

    @property
    def enabled(self) -> int:
        """Bits of the motors whose ENA is on."""
        return self._call("enabled")

    @property
    def outputs(self) -> bool:
        """Whether the line that lets the DACs work is high."""
        return bool(self._call("outputs"))

    @property
    def safe(self) -> bool:
        """No motor enabled and no pressure."""
        return self.enabled == 0 and not self.dac.any()

    def follow(self, follows: bool) -> None:
        """Whether monitors and dynamometers follow the board (True at first); if not they show just what they are set to."""
        self._call("follow", int(follows))

    def tendons(self) -> None:
        """From now on dynamometers that follow show tendons: they run free while their motor is off, and nothing pushes them."""
        self._call("tendons", 1)

    def hold(self, dynamometers: int = 0, monitors: int = 0) -> None:
        """Bits of the sensors that show just what they are set to although the others follow the board."""
        self._call("hold", dynamometers | monitors << 8)

    def monitor(self, channel: int, volts: float) -> None:
        """Voltage of a pressure monitor; where it follows, at no pressure."""
        self._call("monitor", channel, volts)

    def dynamometer(self, channel: int, counts: int) -> None:
        """Counts (15 bits over 5 V) of a dynamometer; where it follows, without tension."""
        self._call("dynamometer", channel, counts)

    def counts_per_step(self, counts: float) -> None:
        """How stiff the tendons are."""
        self._call("counts_per_step", counts)

    def estop(self, pressed: bool) -> None:
        """The emergency stop button."""
        self._call("estop", int(pressed))

    def reset(self, cause: int = PIN) -> None:
        """A reset: `PIN`, `BROWN_OUT`, or `POWER_ON`, which loses the memory."""
        self._call("reset", cause)

    def hang(self) -> None:
        """Make the main loop hang from now on: the first instruction of `loop` becomes a jump to itself. Interrupts go on."""
        self._first_word = self._call("patch", self.symbol("loop"), 0xCFFF)

    def mend(self) -> None:
        """Undo `hang`: what the next reset starts is the firmware as it was built."""
        self._call("patch", self.symbol("loop"), self._first_word)

    def slow(self, share: float) -> None:
        """Take a share of the processor's time away, every 100 us, as interrupts that nobody thought of might."""
        self._call("slow", share)

    def dac_memory(self, code: int) -> None:
        """What DACs with a memory of their own (MCP4728) give from power-on until they are told something."""
        self._call("dac_memory", code)

    def two_wire(self, hung: bool = False, absent: int = 0, stuck: int = 0) -> None:
        """What is wrong with the two-wire bus: a line that is held low; bits of the chips that do not answer; clocks that one waits for."""
        self._call("twi", int(hung), absent, stuck)

    def byte(self, name: str) -> int:
        """First byte of a variable now."""
        return self._call("byte", self.symbol(name) & 0xFFFF)

    def write(self, address: int, data: bytes) -> None:
        """Change the processor's memory."""
        for k, byte in enumerate(data):
            self._call("write", address + k, byte)

    def watch(self) -> None:
        """Begin to note signs of life of the main loop and how often it has nothing to do."""
        self._watched_from = self.cycle
        self._call("watch", self.symbol("patience") & 0xFFFF, self.symbol("loop"))

    def poke(self, name: str, value: int, size: int = 2, index: int = 0) -> None:
        """Write a number of `size` bytes into an element of a variable, as a fault of the memory would."""
        self.write(self.symbol(name) + index * size & 0xFFFF, (value % 256**size).to_bytes(size, "little"))

    def share(self, place: str | int, length: int) -> None:
        """Begin to count how often a variable or register that an interrupt changes is read with interrupts on."""
        self._call("share", (self.symbol(place) if isinstance(place, str) else place) & 0xFFFF, length)

    @property
    def unguarded(self) -> int:
        """How often since `share`."""
        return self._call("unguarded")

    @property
    def worst_gap(self) -> float:
        """Longest time in s between two signs of life since `watch`."""
        return self._call("worst_gap") / HZ

    @property
    def longest_pass(self) -> float:
        """Longest time in s that the main loop took for its turn since `watch`: more than 1 ms is late."""
        return self._call("longest_loop") / HZ

    @property
    def idle(self) -> float:
        """Share of the time since `watch` in which the main loop waited, without interrupts."""
        return self._call("idle_cycles") / (self.cycle - self._watched_from)

    def symbol(self, name: str) -> int:
        """Address of a function in the flash memory, or of a variable (behind 0x800000), by its name without namespaces."""
        lines = _symbols(self.firmware, self.firmware.stat().st_mtime_ns)
        mangled = re.compile(rf"{name}|_Z[NL].*{len(name)}{name}E?(\.lto_priv\.\d+)?v?")
        found = [int(line.split()[0], 16) for line in lines if mangled.fullmatch(line.split()[-1])]
        if len(found) != 1:
            raise KeyError(f"{len(found)} symbols are called {name}")
        return found[0]

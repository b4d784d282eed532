"""The firmware's decoder compiled for this machine, and streams of damaged frames."""

from __future__ import annotations

import ctypes
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tepm_opt.hw.board.protocol import Message
from tests.hw.emulator import HERE

WIDTH = 64


def build_frames(folder: Path) -> Path:
    """The library; the address sanitizer's cheaper relatives stop it where it reads or writes outside an array of known size."""
    target = folder / "frames.so"
    checks = ["-fsanitize=bounds,shift,signed-integer-overflow", "-fsanitize-undefined-trap-on-error"]
    subprocess.run(
        ["c++", "-O2", "-Wall", "-Wextra", "-Werror", *checks, "-shared", "-fPIC", "-o", str(target), str(HERE / "frames.cpp")], check=True
    )
    return target


@dataclass(frozen=True)
class Stream:
    """Groups of one damaged frame and `whole` good ones.

    Attributes:
        data: the bytes.
        ends: where each frame's bytes end.
        payloads: what each was before it was damaged, (frames, 64), filled up with zeros.
        whole: good frames after each damaged one.
    """

    data: bytes
    ends: np.ndarray
    payloads: np.ndarray
    whole: int


@dataclass(frozen=True)
class Decoded:
    """Frames with the right CRC.

    Attributes:
        at: index of the byte that ended each.
        lengths: of the payloads.
        payloads: (frames, 64), filled up with zeros.
    """

    at: np.ndarray
    lengths: np.ndarray
    payloads: np.ndarray

    def messages(self, kinds: tuple[Message, ...]) -> np.ndarray:
        """Which of them are messages of these kinds."""
        return self.lengths == _sizes(kinds)[self.payloads[:, 0]]

    def list(self, kinds: tuple[Message, ...]) -> list[bytes]:
        """Payloads of those that are messages of these kinds."""
        chosen = self.messages(kinds)
        return [row.tobytes()[:length] for row, length in zip(self.payloads[chosen], self.lengths[chosen], strict=True)]


def _sizes(kinds: tuple[Message, ...]) -> np.ndarray:
    sizes = np.zeros(256, np.uint8)
    for kind in kinds:
        sizes[kind.code] = kind.layout.size
    return sizes


class Frames:
    """The library."""

    def __init__(self, path: Path) -> None:
        self._library = ctypes.CDLL(str(path))
        array, pointer = np.ctypeslib.ndpointer, ctypes.c_void_p
        u8, u32 = array(np.uint8, flags="C"), array(np.uint32, flags="C")
        self._library.frame.argtypes = [ctypes.c_char_p, ctypes.c_uint8, ctypes.c_char_p]
        self._library.stream.argtypes = [ctypes.c_uint64, ctypes.c_uint32, ctypes.c_uint32, u8, u8, u32, u8]
        self._library.decoder_new.restype = pointer
        self._library.decoder_free.argtypes = self._library.decoder_bad.argtypes = [pointer]
        self._library.decoder_bad.restype = ctypes.c_uint16
        self._library.decode.argtypes = [pointer, ctypes.c_char_p, ctypes.c_uint32, u32, u8, u8]

    def frame(self, payload: bytes) -> bytes:
        """As the board sends it."""
        out = ctypes.create_string_buffer(256)
        length = self._library.frame(payload, len(payload), out)
        return out.raw[:length]

    def stream(self, seed: int, groups: int, kinds: tuple[Message, ...], whole: int = 2) -> Stream:
        """Damaged and good frames with random contents."""
        frames = groups * (whole + 1)
        data, ends = np.zeros(frames * 70 + groups * 400, np.uint8), np.zeros(frames, np.uint32)
        payloads = np.zeros((frames, WIDTH), np.uint8)
        length = self._library.stream(seed, groups, whole, _sizes(kinds), data, ends, payloads)
        return Stream(data[:length].tobytes(), ends, payloads, whole)

    def decoder(self) -> Decoder:
        """A decoder as the board has it."""
        return Decoder(self._library)


class Decoder:
    """The board's decoder."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library = library
        self._handle = library.decoder_new()

    def __del__(self) -> None:
        self._library.decoder_free(self._handle)

    def feed(self, data: bytes) -> Decoded:
        """Frames that became complete with these bytes."""
        most = len(data) // 4 + 1
        at, lengths, payloads = np.zeros(most, np.uint32), np.zeros(most, np.uint8), np.zeros((most, WIDTH), np.uint8)
        count = self._library.decode(self._handle, data, len(data), at, lengths, payloads)
        return Decoded(at[:count], lengths[:count], payloads[:count])

    @property
    def bad(self) -> int:
        """Frames that were not right, modulo 65,536."""
        return self._library.decoder_bad(self._handle)

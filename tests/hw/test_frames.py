"""Frames: what goes in comes out, and what was damaged on the line does not come out as something else — in C++ and in Python."""

from __future__ import annotations

import binascii
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.protocol import ASK, CONFIG, DISARM, ESTOP, SET, TO_BOARD, TO_HOST, Message
from tests.hw.emulator import FIRMWARE
from tests.hw.emulator.frames import Decoded, Frames, Stream
from tests.hw.emulator.host import Host

LIMITS = {"B": (0, 255), "H": (0, 65535), "h": (-32768, 32767), "I": (0, 2**32 - 1)}
ALL_KINDS = (*TO_BOARD, *TO_HOST)
GROUPS = 50_000


@st.composite
def messages(draw: st.DrawFn) -> tuple[Message, dict[str, Any]]:
    """A message of any kind with any values."""
    kind = draw(st.sampled_from(ALL_KINDS))
    values: dict[str, Any] = {}
    for name, code in kind.fields:
        one = st.integers(*LIMITS[code[-1]])
        values[name] = tuple(draw(st.lists(one, min_size=int(code[:-1]), max_size=int(code[:-1])))) if len(code) > 1 else draw(one)
    return kind, values


@st.composite
def pieces(draw: st.DrawFn, data: bytes) -> list[bytes]:
    """The same bytes, split anywhere."""
    cuts = sorted(draw(st.lists(st.integers(0, len(data)), max_size=12)))
    return [data[begin:end] for begin, end in zip([0, *cuts], [*cuts, len(data)], strict=True)]


def both(frames: Frames, parts: list[bytes]) -> tuple[list[bytes], list[bytes]]:
    """Payloads that the C++ and the Python decoder find in a stream that comes in these parts."""
    native, python = frames.decoder(), protocol.Decoder(ALL_KINDS)
    ours = [payload for part in parts for payload in native.feed(part).list(ALL_KINDS)]
    theirs = [kind.pack(**values) for part in parts for kind, values in python.feed(part)]
    return ours, theirs


def test_header_is_written_from_the_protocol() -> None:
    """The firmware was compiled with the messages that the host speaks."""
    assert (FIRMWARE / "protocol.h").read_text() == protocol.header()


@given(message=messages())
def test_round_trip(frames: Frames, message: tuple[Message, dict[str, Any]]) -> None:
    """Both sides write the same bytes, and read from them what was written."""
    kind, values = message
    payload = kind.pack(**values)
    data = protocol.frame(payload)
    assert frames.frame(payload) == data
    assert data.count(0) == 1
    assert both(frames, [data]) == ([payload], [payload])
    assert protocol.Decoder((kind,)).feed(data) == [(kind, values)]


@given(data=st.data(), sent=st.lists(messages(), max_size=6))
def test_split_anywhere(frames: Frames, data: st.DataObject, sent: list[tuple[Message, dict[str, Any]]]) -> None:
    """It does not matter in which portions a stream arrives."""
    payloads = [kind.pack(**values) for kind, values in sent]
    parts = data.draw(pieces(b"".join(map(protocol.frame, payloads))))
    assert both(frames, parts) == (payloads, payloads)


@given(data=st.data(), garbage=st.binary(max_size=600), message=messages())
def test_any_bytes(frames: Frames, data: st.DataObject, garbage: bytes, message: tuple[Message, dict[str, Any]]) -> None:
    """Whatever comes, both decoders agree on it, and understand the second good frame after it."""
    payload = message[0].pack(**message[1])
    good = protocol.frame(payload)
    ours, theirs = both(frames, data.draw(pieces(garbage + good + good)))
    assert ours == theirs
    assert ours[-1] == payload


@given(message=messages(), length=st.integers(0, 60))
def test_truncated(frames: Frames, message: tuple[Message, dict[str, Any]], length: int) -> None:
    """A frame whose end is missing takes the next one with it at the most."""
    payload = message[0].pack(**message[1])
    good = protocol.frame(payload)
    part = good[: min(length, len(good) - 1)]
    whole = [payload, payload] if len(part) == len(good) - 1 else [payload]  # all but the zero that ends it is there
    assert both(frames, [part, b"\0", good]) == (whole, whole)
    ours, theirs = both(frames, [part, good, good])
    assert ours == theirs
    assert ours[-1] == payload


def check(stream: Stream, decoded: Decoded, kinds: tuple[Message, ...]) -> tuple[int, int, np.ndarray]:
    """What came through of a damaged stream.

    A CRC that begins at 0 stands at 0 again after a whole frame, so whole frames that grew together have a right one too, and one that got
    a zero at its end. They are not counted as wrong here, but they are where they pass for a message: they never do, being longer than the
    message that they begin with.

    Returns:
        frames with the right CRC and a wrong content; wrong messages; which chunks were understood.
    """
    chunk = np.searchsorted(stream.ends, decoded.at, side="right")
    own = (decoded.payloads == stream.payloads[chunk]).all(1)
    before = (decoded.payloads == stream.payloads[np.maximum(chunk - 1, 0)]).all(1)  # its end came with the next
    wrong = ~(own | before)
    mistaken = int((wrong & decoded.messages(kinds)).sum())
    wrong[wrong] = [not _together(row.tobytes()[:n]) for row, n in zip(decoded.payloads[wrong], decoded.lengths[wrong], strict=True)]
    understood = np.zeros(len(stream.ends), bool)
    understood[chunk[own]] = True
    return int(wrong.sum()), mistaken, understood


def _together(payload: bytes) -> bool:
    """Whether the frame begins with something that has a right CRC itself."""
    remainder = 0
    for byte in payload + binascii.crc_hqx(payload, 0).to_bytes(2, "big")[:1]:
        remainder = binascii.crc_hqx(bytes([byte]), remainder)
        if remainder == 0:
            return True
    return False


def bound(count: int) -> float:
    """Damaged frames of `count` that a CRC of 16 bits lets pass at most: the expectation and five standard deviations."""
    return count / 2**16 + 5 * np.sqrt(count / 2**16) + 1


@pytest.mark.parametrize("streams", [4, pytest.param(20, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kinds", [TO_BOARD, TO_HOST], ids=["to the board", "to the host"])
def test_damaged_frames(frames: Frames, kinds: tuple[Message, ...], streams: int) -> None:
    """The board's decoder and 2 · 10^5 damaged frames, 10^6 by `pytest -m slow`: wrong ones pass as rarely as the CRC promises, and of two
    good frames one is understood.

    What is judged is everything between two zeros that is not understood as what was sent, more trials than frames; five standard
    deviations above 2^-16 of them are the bound (15.3 are expected in 10^6 where all damage is random, fewer as bursts of up to 16 bits are
    always seen).
    """
    groups = wrong = mistaken = through = trials = 0
    decoder = frames.decoder()
    for seed in range(streams):
        stream = frames.stream(seed, GROUPS, kinds)
        one, other, understood = check(stream, decoder.feed(stream.data), kinds)
        grouped = understood.reshape(GROUPS, 3)
        assert grouped[:, 2].all()
        groups, wrong, mistaken, through = groups + GROUPS, wrong + one, mistaken + other, through + grouped[:, 0].sum()
        trials += sum(map(bool, stream.data.split(b"\0"))) - understood.sum()
    print(f"{groups} damaged frames, {trials} trials: {wrong} with a right CRC, {mistaken} of them a message; {through} came through")
    assert trials > groups == streams * GROUPS
    assert wrong <= bound(trials)
    assert mistaken <= bound(trials) / 8  # of those with a right CRC few have a code and the length that belongs to it
    assert mistaken <= wrong  # none of those that grew together
    assert through < 0.3 * groups  # the fuzzer does damage


def agree(frames: Frames, seeds: range) -> None:
    for seed in seeds:
        kinds = TO_BOARD if seed % 2 else TO_HOST
        stream = frames.stream(1000 + seed, GROUPS // 2, kinds)
        native, python = frames.decoder(), protocol.Decoder(kinds)
        decoded = native.feed(stream.data)
        _, mistaken, understood = check(stream, decoded, kinds)
        found = [kind.pack(**values) for kind, values in python.feed(stream.data)]
        assert found == decoded.list(kinds)
        assert understood.reshape(-1, 3)[:, 2].all()
        assert mistaken <= bound(GROUPS // 2)
        other = len(decoded.lengths) - len(found)  # a frame, but not a message
        assert python.bad % 2**16 == (native.bad + other) % 2**16
        assert python.good == len(found)


@pytest.mark.slow
def test_python_agrees(frames: Frames) -> None:
    """The host's decoder finds in 5 · 10^4 damaged frames exactly the messages that the board's decoder finds, and counts the same."""
    agree(frames, range(2))


@pytest.mark.slow
def test_python_agrees_on_a_million(frames: Frames) -> None:
    """The same with 10^6."""
    agree(frames, range(40))


def follow(frames: Frames, host: Host, groups: int) -> None:
    """Damaged frames through the emulated serial port: the board counts and does what its decoder finds on this machine."""
    kinds = (SET, ESTOP, CONFIG, ASK, DISARM)  # not ARM and CLEAR, which would need the right session
    stream = frames.stream(7, groups, kinds, whole=1)
    data = b"\0" + stream.data + b"\0"
    host.run(0.05)
    before = host.status
    for at in range(0, len(data), 55):  # the board reads 60 in that time
        host.board.send(data[at : at + 55])
        host.run(0.005)
    host.run(0.05)
    native = frames.decoder()
    decoded = native.feed(data)
    found = decoded.list(kinds)
    stale = sum(payload[0] == SET.code for payload in found)  # none is of this session
    _, mistaken, _ = check(stream, frames.decoder().feed(stream.data), kinds)
    assert mistaken <= bound(groups)
    assert host.status["good"] == (before["good"] + len(found)) % 2**16
    assert host.status["bad"] == (before["bad"] + native.bad + len(decoded.lengths) - len(found)) % 2**16
    assert (host.status["sequence"], host.status["refused"], host.status["stale"]) == (0, 0, stale % 256)
    assert host.status["late"] == before["late"]
    assert host.board.safe
    assert not host.board.step_counts.any()


@pytest.mark.slow
def test_damaged_frames_on_the_emulator(frames: Frames, host: Host) -> None:
    """500 damaged frames."""
    follow(frames, host, 500)


@pytest.mark.slow
def test_many_damaged_frames_on_the_emulator(frames: Frames, host: Host) -> None:
    """10^4 damaged frames."""
    follow(frames, host, 10_000)

"""The log of a line: its end is kept, however long a session lasts; it never stops what it is a log of."""

from __future__ import annotations

import builtins
import io
from pathlib import Path

import pytest

from tepm_opt.errors import InputError
from tepm_opt.hw.board import linklog
from tepm_opt.hw.board.linklog import KEPT_FILES, LinkLog, PlaybackPort, new_log, read_log


class Time:
    """A clock that is a second further whenever it is looked at."""

    now = 99.0

    def __call__(self) -> float:
        self.now += 1.0
        return self.now


def written(path: Path, count: int, limit: int, size: int = 10) -> LinkLog:
    """A log of `count` lines, each with its number."""
    log = LinkLog(path, Time(), limit)
    for k in range(count):
        log("<>"[k % 2], k.to_bytes(size, "big"))
    log.close()
    return log


def size(folder: Path) -> int:
    """Bytes of all files."""
    return sum(path.stat().st_size for path in folder.iterdir())


@pytest.mark.parametrize("count", [30, 60, 100, 1000])
def test_its_end_is_kept(tmp_path, count):
    """Never more than the limit on the disk, and always the newest lines, of at least half of it, without a gap."""
    limit = 2000
    log = LinkLog(tmp_path / "link-1.log", Time(), limit)
    for k in range(count):
        log("<>"[k % 2], k.to_bytes(10, "big"))
        assert size(tmp_path) <= limit
    log.close()
    kept = list(read_log(log.path))
    numbers = [int.from_bytes(data, "big") for _, _, data in kept]
    assert numbers == list(range(count - len(kept), count))
    assert [time for time, _, _ in kept] == [k + 1.0 for k in numbers]
    assert [direction for _, direction, _ in kept] == ["<>"[k % 2] for k in numbers]
    assert len(kept) >= min(count, limit // 2 // len(f"{count}.000000 < {'00' * 10}\n") - 2)


def test_a_long_one_says_so(tmp_path):
    """In its first line, with what is missing; a short one has no such line."""
    short = written(tmp_path / "short.log", 10, 2000)
    assert "#" not in short.path.read_text()
    log = written(tmp_path / "link-1.log", 100, 2000)
    first = log.path.read_text().splitlines()[0]
    kept = [line for path in tmp_path.glob("link-1*") for line in path.read_text().splitlines() if line[0] != "#"]
    every = sum(len(f"{k + 1}.000000 < {'00' * 10}\n") for k in range(100))
    assert first.startswith("# goes on from link-1.before.log; ")
    lost = int(first.split(";")[1].split()[0])
    remarks = lost + sum(len(line) + 1 for line in kept) - every
    assert 0 < remarks < 80 * 4  # the first lines of the parts that went


def test_the_older_part_can_be_read_alone(tmp_path):
    log = written(tmp_path / "link-1.log", 100, 2000)
    before = list(read_log(tmp_path / "link-1.before.log"))
    assert 0 < len(before) < 50
    assert list(read_log(log.path))[: len(before)] == before
    (tmp_path / "link-1.before.log").unlink()
    assert len(list(read_log(log.path))) > 0


def test_a_part_of_another_log_is_not_read(tmp_path):
    """Only a log that says that it goes on from another one has its lines before it."""
    log = written(tmp_path / "link-1.log", 10, 2000)
    written(tmp_path / "link-1.before.log", 10, 2000)
    assert len(list(read_log(log.path))) == 10


def test_a_long_one_plays_back(tmp_path):
    """From its first line's time on, all that came and is kept."""
    log = written(tmp_path / "link-1.log", 100, 2000)
    kept = list(read_log(log.path))
    port = PlaybackPort(log.path)
    assert port.clock() == kept[0][0] > 30
    came = []
    while port.clock() < 99:
        if data := port.read(0.25):
            came.append((port.clock(), "<", data))
    with pytest.raises(EOFError, match=r"the log ended at 99\.000 s"):
        port.read(0.25)
    assert came == [line for line in kept if line[1] == "<"]


def test_it_is_read_line_by_line(tmp_path):
    """What is wrong further on is told when it is come to; a file without line ends is not taken for one."""
    path = tmp_path / "link.log"
    path.write_text("0.1 < 0102\n" * 1000 + "nonsense\n")
    port = PlaybackPort(path)
    for _ in range(999):
        assert port.read(1.0) == b"\1\2"
    with pytest.raises(InputError, match="line 1001: 'nonsense'"):
        port.read(1.0)
    path.write_text("")
    assert list(read_log(path)) == []
    with pytest.raises(EOFError):
        PlaybackPort(path).read(1.0)
    path.write_bytes(b"\xff\xfe\n")
    with pytest.raises(InputError, match="is not a log of a serial line"):
        PlaybackPort(path)


def test_a_file_without_lines_takes_no_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(linklog, "_LONGEST", 100)
    path = tmp_path / "link.log"
    path.write_text("0" * 1000)
    with pytest.raises(InputError, match="is not a log of a serial line"):
        list(read_log(path))


def test_the_folder_is_bounded(tmp_path, monkeypatch):
    """By files and by bytes, a whole new log included; the oldest go first, and what is not a log stays."""
    monkeypatch.setattr(linklog, "FOLDER_LIMIT", linklog.LIMIT + 1000)
    (tmp_path / "other.txt").write_text("x" * 5000)
    for k in range(2 * KEPT_FILES):
        (tmp_path / f"link-20260101-{k:06d}-0.log").write_text("x")
    log = new_log(tmp_path, Time())
    log.close()
    left = sorted(path.name for path in tmp_path.glob("link-*"))
    assert left == [*(f"link-20260101-{k:06d}-0.log" for k in range(KEPT_FILES + 1, 2 * KEPT_FILES)), log.path.name]
    for k, name in enumerate(left[-4:]):
        (tmp_path / name).write_text("y" * (300 if k else 700))
    (tmp_path / left[-2].replace(".log", ".before.log")).write_text("y" * 300)
    new_log(tmp_path, Time()).close()
    assert [path.name for path in sorted(tmp_path.glob("link-*"))][:-1] == sorted([*left[-2:], left[-2].replace(".log", ".before.log")])
    assert (tmp_path / "other.txt").exists()


def note(log: LinkLog, lines: int) -> None:
    """Some lines, and the log's end."""
    for _ in range(lines):
        log(">", b"123456")
    log.close()


class Full(io.StringIO):
    """A file on a disk that takes so many characters."""

    def __init__(self, room: int) -> None:
        super().__init__()
        self.room = room

    def write(self, text: str) -> int:
        if self.tell() + len(text) > self.room:
            raise OSError(28, "No space left on device")
        return super().write(text)


def test_a_full_disk_ends_the_log_not_the_session(tmp_path, monkeypatch):
    monkeypatch.setattr(Path, "open", lambda *_, **__: Full(100))
    log = LinkLog(tmp_path / "link.log", Time())
    with pytest.warns(RuntimeWarning, match=r"link\.log: the log of the line ends here: No space left on device") as told:
        note(log, 20)
    assert len(told) == 1


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no such device")
def test_a_disk_that_is_full_when_it_is_closed(tmp_path, monkeypatch):
    monkeypatch.setattr(Path, "open", lambda self, *given, **options: builtins.open("/dev/full", "w"))  # noqa: PTH123, SIM115
    log = LinkLog(tmp_path / "link.log", Time())
    with pytest.warns(RuntimeWarning, match="No space left on device"):
        note(log, 1)
    note(log, 1)

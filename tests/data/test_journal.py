"""Journals: every appended row is in the file at once; a torn end does no harm."""

from __future__ import annotations

from pathlib import Path

import pytest

from tepm_opt.data.journal import Journal, mend_journal
from tepm_opt.data.tables import read_table
from tepm_opt.errors import InputError


def test_rows_are_there_before_it_is_closed(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    with Journal(path, ["x", "status"]) as journal:
        for k in range(3):
            journal.append([repr(k / 3), "lost\ns1, again"])
            assert len(path.read_bytes().splitlines()) == k + 2
    table = read_table(path, text=lambda name: name == "status")
    assert table.columns["x"].tolist() == [0, 1 / 3, 2 / 3]
    assert set(table.columns["status"]) == {"lost s1, again"}


def test_every_torn_end_is_mended(tmp_path: Path) -> None:
    whole = b"x,y\n1.5,2\n3,4\n"
    for length in range(len(whole) + 1):
        path = tmp_path / f"{length}.csv"
        path.write_bytes(whole[:length])
        rows = mend_journal(path)
        assert rows == max(whole[:length].count(b"\n") - 1, 0)
        assert path.read_bytes() == whole[: whole[:length].rfind(b"\n") + 1]


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text("old")
    with pytest.raises(InputError, match="exists"):
        Journal(tmp_path / "run.csv", ["x"])
    assert (tmp_path / "run.csv").read_text() == "old"
    with pytest.raises(InputError, match="cannot be written"):
        Journal(tmp_path / "none" / "run.csv", ["x"])


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_a_full_disk_is_one_line(tmp_path: Path) -> None:
    with Journal(tmp_path / "run.csv", ["x"]) as journal, open("/dev/full", "wb", buffering=0) as full:  # noqa: PTH123
        own, journal._file = journal._file, full.fileno()
        with pytest.raises(InputError, match=r"run\.csv: cannot be written: No space left"):
            journal.append(["1"])
        journal._file = own

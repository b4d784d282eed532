"""Files are whole or absent."""

import os
import stat

import pytest

from tepm_opt.data.files import atomic_path, output_folder, write_atomically
from tepm_opt.errors import InputError


def test_an_exception_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "result.csv"
    path.write_text("old")

    def fail_half_way():
        with atomic_path(path) as temporary:
            temporary.write_text("half of the n")
            assert temporary.parent == tmp_path  # renaming is atomic only within a file system
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail_half_way()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_an_exception_makes_no_new_file(tmp_path):
    with pytest.raises(KeyboardInterrupt), atomic_path(tmp_path / "result.csv"):
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_the_file_replaces_the_old_one_with_usual_permissions(tmp_path):
    path = tmp_path / "result.csv"
    path.write_text("old")
    write_atomically(path, "new: α\n")
    other = tmp_path / "other"
    other.touch()
    assert path.read_bytes() == "new: α\n".encode()
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(other.stat().st_mode)
    assert sorted(tmp_path.iterdir()) == [other, path]


@pytest.mark.parametrize("name", ["missing/result.csv", "file/result.csv", "folder"])
def test_what_cannot_be_written_is_named(tmp_path, name):
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="cannot be written") as error:
        write_atomically(tmp_path / name, "text")
    assert str(tmp_path / name) in str(error.value)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["file", "folder"]


def test_output_folder_is_made(tmp_path):
    assert output_folder(tmp_path / "a" / "b").is_dir()
    assert output_folder(tmp_path / "a" / "b") == tmp_path / "a" / "b"


def test_output_folder_that_is_a_file(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="is a file"):
        output_folder(tmp_path / "file")
    with pytest.raises(InputError, match="cannot be made"):
        output_folder(tmp_path / "file" / "below")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
def test_output_folder_that_is_read_only(tmp_path):
    tmp_path.chmod(0o555)
    with pytest.raises(InputError, match="read-only"):
        output_folder(tmp_path)

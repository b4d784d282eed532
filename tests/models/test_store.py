"""Libraries that are kept: what another user could have written is never run, and what is broken is compiled anew."""

import os
import stat
import subprocess
from pathlib import Path

import pytest

from tepm_opt.models.backends import compiler as c_compiler
from tepm_opt.models.backends import store
from tepm_opt.models.backends.compiler import find_compiler
from tepm_opt.models.compile import CompiledModel, compile_model
from tests.models.test_compile import SMALL

pytestmark = [pytest.mark.skipif(os.name != "posix", reason="owners and modes of POSIX"), pytest.mark.usefixtures("compiler")]


@pytest.fixture(scope="module")
def content(compiler, tmp_path_factory) -> bytes:
    """The library of a small model."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(store.CACHE_VARIABLE, str(tmp_path_factory.mktemp("cache")))
        compiled()
        (path,) = store.cache_folder().glob("*.so")
    return path.read_bytes()


@pytest.fixture
def compilations(content, monkeypatch) -> list[str]:
    """A list that gets the object files of each library that is linked; neither that nor compiling takes time."""
    linked = []
    monkeypatch.setattr(c_compiler, "_compile", lambda compiler, text, flags: text.encode())
    monkeypatch.setattr(c_compiler, "_link", lambda compiler, objects, flags: linked.append(objects) or content)
    return linked


@pytest.fixture
def kept(empty_cache, compilations) -> Path:
    """A library in the cache that a first compilation kept."""
    compiled()
    assert len(compilations) == 1
    compilations.clear()
    (path,) = empty_cache.glob("*.so")
    return path


def compiled() -> CompiledModel:
    """A small model in C, which must be found to work."""
    model = compile_model(SMALL, backend="c")
    assert model.is_c
    assert (model.statics.actuation(model.input_max, model.theta) == model.reference.actuation(model.input_max, model.theta)).all()
    return model


def library(path: Path, text: str) -> bytes:
    """A C text as a library."""
    path.with_suffix(".c").write_text(text, encoding="utf-8")
    command = [*(find_compiler() or ()), "-shared", "-fPIC", "-o", str(path), str(path.with_suffix(".c"))]
    subprocess.run(command, check=True, capture_output=True)
    return path.read_bytes()


def give_away(path: Path) -> None:
    """Let a file be another user's."""
    if os.geteuid():
        pytest.skip("only root can give a file to another user")
    os.chown(path, 65534, 65534)


@pytest.fixture
def evil(tmp_path) -> tuple[bytes, Path]:
    """A library that makes a file when it is loaded, and that file."""
    trace = tmp_path / "was here"
    text = f'#include <stdio.h>\n__attribute__((constructor)) static void run(void) {{ fclose(fopen("{trace}", "w")); }}\n'
    return library(tmp_path / "evil.so", text), trace


@pytest.mark.slow
def test_it_is_closed_to_others_from_the_start(empty_cache, compilations):
    mask = os.umask(0)
    try:
        compiled()
    finally:
        os.umask(mask)
    (path,) = empty_cache.glob("*.so")
    assert stat.S_IMODE(empty_cache.stat().st_mode) == 0o700
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


@pytest.mark.parametrize("how", ["link", "writable", "group", "stranger"])
def test_a_folder_that_others_control_is_not_used(empty_cache, kept, compilations, evil, tmp_path, how):
    """Neither read nor written, whatever lies in it; a folder of this process stands for it, with a warning that says why."""
    content, trace = evil
    there = tmp_path / "elsewhere" if how == "link" else empty_cache
    if how == "link":
        empty_cache.rename(there)
        empty_cache.symlink_to(there)
    (path,) = there.glob("*.so")
    before = sorted(there.iterdir())
    path.write_bytes(content)
    there.chmod({"writable": 0o777, "group": 0o770}.get(how, 0o700))
    if how == "stranger":
        give_away(there)
    says = {"link": "is a symbolic link", "writable": "may be .*mode 777", "group": "may be .*mode 770", "stranger": "belongs to user"}
    with pytest.warns(RuntimeWarning, match=f"compiled models are not kept: {empty_cache}: {says[how]}.*; valid: a folder of your own"):
        compiled()
    assert len(compilations) == 1
    assert not trace.exists()
    assert path.read_bytes() == content
    assert sorted(there.iterdir()) == before


@pytest.mark.parametrize("how", ["same name", "own digest", "stranger", "writable", "link", "pipe", "folder"])
def test_a_file_that_others_may_have_written_is_not_loaded(kept, compilations, evil, how):
    """The library is compiled anew, and takes its place."""
    content, trace = evil
    stem = kept.stem.rpartition("-")[0]
    path = kept if how == "same name" else kept.with_name(f"{stem}-{store._digest(content)}.so")
    kept.unlink()
    if how == "link":
        path.symlink_to(trace.with_name("evil.so"))
    elif how == "pipe":
        os.mkfifo(path)
    elif how == "folder":
        path.mkdir()
    else:
        path.write_bytes(content)
        path.chmod(0o666 if how == "writable" else 0o600)
        if how == "stranger":
            give_away(path)
    compiled()
    assert len(compilations) == 1
    assert trace.exists() == (how == "own digest")  # its owner put it there: it is loaded, and found not to have the symbols
    assert [each for each in kept.parent.glob("*.so") if each.is_file() and not each.is_symlink()] == [kept]


@pytest.mark.parametrize("how", ["cut", "empty", "text", "flipped", "of another unit"])
def test_a_broken_library_is_compiled_anew(kept, compilations, content, tmp_path, how):
    """Not even tried: one that was cut short would end the process."""
    if how == "of another unit":
        other = library(tmp_path / "other.so", "int integrate(void) { return 0; }")
        kept.rename(kept.with_name(f"{kept.stem.rpartition('-')[0]}-{store._digest(other)}.so")).write_bytes(other)
    else:
        middle = len(content) // 2
        flipped = content[:middle] + bytes(255 - byte for byte in content[middle : middle + 64]) + content[middle + 64 :]
        kept.unlink()
        kept.write_bytes({"cut": content[:middle], "empty": b"", "text": b"#!/bin/sh\n", "flipped": flipped}[how])
    compiled()
    assert len(compilations) == 1
    assert kept.read_bytes() == content
    assert list(kept.parent.glob("*.so")) == [kept]
    compiled()
    assert len(compilations) == 1


@pytest.mark.parametrize("how", ["flipped", "writable", "link"])
def test_an_object_file_that_others_may_have_written_is_not_linked(kept, compilations, tmp_path, how):
    """Its text is compiled anew."""
    honest = min(kept.parent.glob("input_map-*.o"))
    content = honest.read_bytes()
    kept.unlink()
    if how == "link":
        honest.rename(tmp_path / "evil.o")
        honest.symlink_to(tmp_path / "evil.o")
    else:
        honest.write_bytes(content if how == "writable" else content[::-1])
        honest.chmod(0o666 if how == "writable" else 0o600)
    compiled()
    (objects,) = compilations
    assert content in objects
    assert content[::-1] not in objects
    assert not honest.is_symlink()
    assert stat.S_IMODE(honest.stat().st_mode) == 0o600


def test_a_folder_that_is_put_in_its_place_meanwhile_is_not_looked_at(kept, tmp_path):
    """Whoever owns a folder above can rename; the opened folder stays the one that was checked."""
    if not Path("/proc/self/fd").is_dir():
        pytest.skip("no /proc on this system")
    with store.opened_folder() as folder:
        kept.parent.rename(tmp_path / "gone")
        kept.parent.mkdir()
        assert [path.name for path in folder.glob("*.so")] == [kept.name]

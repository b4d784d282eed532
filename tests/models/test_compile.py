"""Compiling: generated C is a cache and never a requirement; what is given to a compiled model is checked."""

import shutil
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.models.backends import compiler as c_compiler
from tepm_opt.models.backends import store
from tepm_opt.models.backends.written import SUFFIX
from tepm_opt.models.compile import compile_model
from tepm_opt.models.model import Model
from tests.tools import variant

SMALL = variant(geometry={"modules": 1, "segments_per_module": 1, "bracing": "single"})


def test_without_a_compiler_python_runs_and_says_so_once(empty_cache, monkeypatch, recwarn):
    monkeypatch.setattr(c_compiler, "find_compiler", lambda: None)
    models = [compile_model(SMALL) for _ in range(2)]
    assert not any(model.is_c for model in models)
    assert [str(warning.message)[:20] for warning in recwarn] == ["no C compiler found:"]
    with pytest.raises(InputError, match="backend 'c': no working C compiler"):
        compile_model(SMALL, backend="c")


def test_a_compiler_that_fails_is_no_obstacle(empty_cache, monkeypatch):
    monkeypatch.setattr(c_compiler, "find_compiler", lambda: (shutil.which("false") or "/bin/false",))
    with pytest.warns(RuntimeWarning, match="compiling failed: CasADi's virtual machine is used"):
        model = compile_model(SMALL)
    assert not model.is_c
    assert {path.suffix for path in empty_cache.iterdir()} == {SUFFIX}, "no library, no object file"


@pytest.mark.slow
def test_a_cache_that_cannot_be_made_is_no_obstacle(tmp_path, empty_cache, monkeypatch, compiler):
    (tmp_path / "file").touch()
    monkeypatch.setenv(store.CACHE_VARIABLE, str(tmp_path / "file" / "cache"))
    with pytest.warns(RuntimeWarning, match="compiled models are not kept: .*cache: Not a directory; valid: a folder of your own"):
        assert compile_model(SMALL).is_c


@pytest.mark.slow
def test_the_cache_is_keyed_by_the_network_not_by_its_parameters(empty_cache, monkeypatch, compiler):
    model = Model.from_robot(SMALL)
    assert compile_model(model, backend="c").is_c
    libraries = sorted(empty_cache.iterdir())
    assert [library.suffix for library in libraries].count(".so") == 1
    monkeypatch.setattr(c_compiler.subprocess, "run", None)  # a second compilation would fail
    assert compile_model(model.with_parameters(K_a=300.0), backend="c").is_c
    assert sorted(empty_cache.iterdir()) == libraries


@pytest.mark.slow
def test_it_is_told_how_much_is_compiled(empty_cache, compiler):
    told = []
    with c_compiler.report_to(lambda stage, done, of: told.append((stage, done, of))):
        compile_model(SMALL, backend="c")
    parts = len(list(empty_cache.glob("*.o")))
    assert told == [("compiling kernels", done, parts) for done in range(parts + 1)]
    compile_model(SMALL, backend="c")
    assert len(told) == parts + 1


@pytest.mark.slow
def test_who_comes_while_it_is_compiled_waits_for_it(empty_cache, monkeypatch, compiler):
    compiled, compile_text, together = Counter(), c_compiler._compile, Barrier(2)

    def counted(*arguments):  # command, text and flags
        compiled[arguments] += 1
        return compile_text(*arguments)

    def load(_):
        together.wait()
        return compile_model(SMALL, backend="c").is_c

    pytest.importorskip("fcntl")
    monkeypatch.setattr(c_compiler, "_compile", counted)
    with ThreadPoolExecutor(2) as pool:
        assert all(pool.map(load, range(2)))
    assert set(compiled.values()) == {1}
    assert {left.suffix for left in empty_cache.iterdir()} == {".so", ".o", ".functions"}


@pytest.mark.parametrize(
    ("inputs", "message"),
    [
        (np.zeros(11), r"inputs: shape \(11,\); valid: \(12,\)"),
        ([0] * 11 + ["x"], "inputs: not numbers"),
        ([0, np.nan] + [0] * 10, "inputs: value 1 is not finite"),
        ([0, 0, 0, 0, 0, 6e5] + [0] * 6, "inputs: pressure_23 = 600000 Pa; valid: 0 … 500000 Pa"),
        ([0] * 6 + [-0.1] + [0] * 5, "inputs: tension_11 = -0.1 N; valid: 0 … 7 N"),
    ],
)
def test_wrong_inputs(kang, inputs, message):
    with pytest.raises(InputError, match=message):
        kang.check_inputs(inputs)


def test_loads_are_on_the_tip_or_on_all_points(kang):
    np.testing.assert_array_equal(kang.check_loads(None), np.zeros((4, 3)))
    np.testing.assert_array_equal(kang.check_loads([1, 2, 3]), [[0] * 3] * 3 + [[1, 2, 3]])
    np.testing.assert_array_equal(kang.check_loads(np.eye(4)[:, :3]), np.eye(4)[:, :3])
    for wrong in ([1, 2], [1, 2, np.inf], np.zeros((3, 3))):
        with pytest.raises(InputError, match="loads: "):
            kang.check_loads(wrong)

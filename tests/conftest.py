"""Compiled models shared by all tests."""

from __future__ import annotations

import pytest
from hypothesis import settings

from tepm_opt.models.ccode import find_compiler
from tepm_opt.models.compile import CompiledModel, compile_model

settings.register_profile("suite", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("suite")


@pytest.fixture(scope="session")
def kang() -> CompiledModel:
    """The nominal robot, in C where there is a compiler."""
    return compile_model("kang2017")


@pytest.fixture(scope="session")
def kang_python() -> CompiledModel:
    """The nominal robot on CasADi's virtual machine."""
    return compile_model("kang2017", backend="python")


@pytest.fixture(scope="session")
def compiler() -> None:
    """Skips tests that need a C compiler where there is none."""
    if find_compiler() is None:
        pytest.skip("no C compiler on this machine")

"""Compiled models shared by all tests; what is slow runs only by `pytest -m slow`."""

from __future__ import annotations

import os

# threads that share matrices of 100 x 100 wait for each other: three times slower on two cores
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import settings

from tepm_opt.models.backends.ccode import find_compiler
from tepm_opt.models.compile import CompiledModel, compile_model

settings.register_profile("suite", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("suite")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.getoption("-m"):
        for item in items:
            if item.get_closest_marker("slow"):
                item.add_marker(pytest.mark.skip(reason="slow: run by `pytest -m slow`"))


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

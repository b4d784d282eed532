"""Compiled models shared by all tests; which tests run, in which order, and what was skipped."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator

# threads that share matrices of 100 x 100 wait for each other: three times slower on two cores
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import settings

from tepm_opt.models.backends.compiler import find_compiler
from tepm_opt.models.compile import CompiledModel, compile_model
from tests.browser import Browser, chromium

settings.register_profile("suite", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("suite")


FIRST = ("tests/test_notebooks.py", "tests/models/")
"""What takes longest alone, and what compiles the models that many tests share."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--turn N`."""
    told = "begin with the tests' third number N modulo 3, so that what a limit of time cuts off has its turn"
    parser.addoption("--turn", type=int, default=0, help=told)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what is slow unless markers are asked for; begin with what takes longest."""
    if not config.getoption("-m"):
        left_out = [item for item in items if item.get_closest_marker("slow") or item.get_closest_marker("study")]
        if left_out:
            config.hook.pytest_deselected(items=left_out)
            items[:] = [item for item in items if item not in set(left_out)]
    items.sort(key=lambda item: next((k for k, folder in enumerate(FIRST) if item.nodeid.startswith(folder)), len(FIRST)))
    begin = config.getoption("--turn") % 3 * len(items) // 3
    items[:] = items[begin:] + items[:begin]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """One line for each reason to skip, with how often it held."""
    reasons = Counter(report.longrepr[2].removeprefix("Skipped: ") for report in terminalreporter.stats.get("skipped", []))
    for reason, count in reasons.most_common():
        terminalreporter.write_line(f"skipped {count}: {reason}")


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


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """Headless Chromium, one for all pages; skips where it is missing."""
    with chromium() as opened:
        yield opened

"""Compiled models shared by all tests; which tests run, in which order, and what was skipped."""

from __future__ import annotations

import gc
import os
from collections import Counter
from collections.abc import Iterator

# threads that share matrices of 100 x 100 wait for each other: three times slower on two cores
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import settings

from tepm_opt.models.backends.compiler import FLAGS_VARIABLE, find_compiler
from tepm_opt.models.compile import CompiledModel, compile_model
from tests import durations
from tests.browser import Browser, chromium

settings.register_profile("fast", deadline=None, derandomize=True, max_examples=20)
settings.register_profile("slow", deadline=None, derandomize=True, max_examples=50)


FIRST = ("tests/test_notebooks.py", "tests/models/")
"""What takes longest alone, and what compiles the models that many tests share."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Declare `--turn N` and `--store-durations`."""
    turn = "begin with the tests' third number N modulo 3, so that tests beyond a time limit have their turn"
    parser.addoption("--turn", type=int, default=0, help=turn)
    parser.addoption("--store-durations", action="store_true", help="write tests/durations.csv from this run of the whole fast suite")


def pytest_configure(config: pytest.Config) -> None:
    """Choose how many examples property tests try; fast tests compile more than they compute, slow ones have users' flags."""
    settings.load_profile("slow" if config.getoption("-m") else "fast")
    if not config.getoption("-m"):
        os.environ.setdefault(FLAGS_VARIABLE, "-O1")


def mark_cases_slow(items: list[pytest.Item]) -> None:
    """Mark as slow all cases of a sampled function but each n-th of those that are not slow anyway."""
    seen: Counter[str] = Counter()
    for item in items:
        sample = item.get_closest_marker("sample")
        if sample and not item.get_closest_marker("slow"):
            function = item.nodeid.partition("[")[0]
            if seen[function] % sample.args[0]:
                item.add_marker("slow")
            seen[function] += 1


def pytest_collection_finish() -> None:
    """Leave what was imported and collected out of every later garbage collection: an eighth of the whole time."""
    gc.collect()
    gc.freeze()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what is slow unless markers are asked for; begin with what takes longest."""
    mark_cases_slow(items)
    if not config.getoption("-m"):
        left_out = [item for item in items if item.get_closest_marker("slow") or item.get_closest_marker("study")]
        if left_out:
            config.hook.pytest_deselected(items=left_out)
            items[:] = [item for item in items if item not in set(left_out)]
    items.sort(key=lambda item: next((k for k, folder in enumerate(FIRST) if item.nodeid.startswith(folder)), len(FIRST)))
    begin = config.getoption("--turn") % 3 * len(items) // 3
    items[:] = items[begin:] + items[:begin]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print each reason to skip with its count; store durations where that was asked for."""
    if terminalreporter.config.getoption("--store-durations"):
        reports = [each for kind in ("passed", "failed", "") for each in terminalreporter.stats.get(kind, [])]
        durations.store((each.nodeid, each.when, each.duration) for each in reports if hasattr(each, "duration"))
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

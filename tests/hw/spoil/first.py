"""A plugin of pytest: tests that are named in SPOIL_FIRST, with commas between, run before all others."""

from __future__ import annotations

import os

import pytest

VARIABLE = "SPOIL_FIRST"


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Move them to the front."""
    first = os.environ.get(VARIABLE, "").split(",")
    items.sort(key=lambda item: item.nodeid.partition("[")[0] not in first)

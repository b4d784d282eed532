"""A plugin of pytest: tests that are named in SPOIL_FIRST, with commas between, run before all others, and slow ones last."""

from __future__ import annotations

import os

import pytest

VARIABLE = "SPOIL_FIRST"


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sort them so; each kind keeps its order."""
    first = os.environ.get(VARIABLE, "").split(",")
    items.sort(key=lambda item: (item.nodeid.partition("[")[0] not in first, item.get_closest_marker("slow") is not None))

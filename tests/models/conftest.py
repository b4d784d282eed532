"""A compile cache of a test's own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tepm_opt.models.backends import store


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A cache folder that is yet to be made, and no warning given so far."""
    monkeypatch.setenv(store.CACHE_VARIABLE, str(tmp_path / "cache"))
    forgotten = store.warn_once, store._own_folder
    for each in forgotten:
        each.cache_clear()
    yield tmp_path / "cache"
    for each in forgotten:
        each.cache_clear()

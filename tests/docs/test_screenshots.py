"""Pictures of the docs: small, all of them shown, none missing."""

from __future__ import annotations

import io
import re
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.docs.texts import DOCUMENTS, ROOT

pytest.importorskip("viser", reason="viser is not installed (extra view)")

from docs import screenshots

IMAGES = ROOT / "docs" / "images"
NAMES = ("page_demo", "page_demo_phone", "page_verdict", "page_curves", "studio_arm", "studio_verdict", "circle")


def test_every_picture_is_shown() -> None:
    shown = {name for path in DOCUMENTS for name in re.findall(r"images/(\w+\.\w+)\)", path.read_text(encoding="utf-8"))}
    assert shown == {path.name for path in IMAGES.iterdir()}


@pytest.mark.parametrize("name", NAMES)
def test_screenshots_are_small(name: str) -> None:
    path = IMAGES / f"{name}.png"
    assert path.stat().st_size <= screenshots.LARGEST
    assert Image.open(path).mode == "P"


def test_as_many_colours_as_fit() -> None:
    """Flat areas keep theirs; noise, which no palette makes small, gets few or is refused."""
    flat = Image.new("RGB", (400, 300), "#17683d")
    kept = Image.open(io.BytesIO(screenshots.shrunk(flat))).convert("RGB")
    assert kept.getpixel((10, 10)) == (0x17, 0x68, 0x3D)
    noise = np.random.default_rng(0).integers(0, 256, (400, 400, 3), dtype=np.uint8)
    small = screenshots.shrunk(Image.fromarray(noise))
    assert len(small) <= screenshots.LARGEST
    assert len(Image.open(io.BytesIO(small)).getcolors() or []) < 256
    with pytest.raises(RuntimeError, match="150000 bytes"):
        screenshots.shrunk(Image.fromarray(np.tile(noise, (4, 4, 1))[:1600, :1600] ^ np.arange(1600, dtype=np.uint8)[:, None, None]))


def test_what_is_there_is_kept(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[list[str]] = []
    monkeypatch.setattr(screenshots, "run", lambda words: asked.append(words) or 0)
    (tmp_path / "demo").mkdir()
    screenshots.prepare(tmp_path)
    assert [words[0] for words in asked] == ["record", "discrepancy"]
    monkeypatch.setattr(screenshots, "run", lambda words: 2)
    with pytest.raises(RuntimeError, match="tepm record standard"):
        screenshots.prepare(tmp_path)

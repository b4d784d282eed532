"""Pictures of the docs: small, all of them shown, none missing."""

from __future__ import annotations

import io
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.docs.texts import DOCUMENTS, ROOT

pytest.importorskip("viser", reason="viser is not installed (extra view)")
pytest.importorskip("selenium", reason="selenium is not installed (extra test)")

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


@pytest.mark.slow
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


def test_the_tutorial_makes_what_is_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its machine, its data, its verdict, in order; what is there is kept, what fails is told."""
    asked: list[str] = []
    monkeypatch.setattr(screenshots.subprocess, "run", lambda words, **_: asked.append(words[-1].partition("\n")[2]))
    (tmp_path / "demo").mkdir()
    screenshots.prepare(tmp_path)
    assert [text.partition(" machine.toml")[0][:20] for text in asked] == [
        "tepm hw rig new", "sed -i 's/^noise_rms", "cat >>", "tepm record standard", "tepm discrepancy ben",
    ]  # fmt: skip
    assert "[imperfections.payload]" in asked[2]
    monkeypatch.undo()
    monkeypatch.setattr(screenshots, "TEPM", "tepm() { return 2; }")
    with pytest.raises(subprocess.CalledProcessError):
        screenshots.prepare(tmp_path)

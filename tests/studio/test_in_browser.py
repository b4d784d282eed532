"""The page in headless Chromium: it opens, asks nobody else, refuses who has no token; the mouse drags the tip, keys move a slider."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("viser", reason="viser is not installed (extra view)")

from PIL import Image

from tepm_opt.models.compile import CompiledModel
from tepm_opt.studio.page import Studio
from tepm_opt.studio.shapes import PRESSURE
from tests.browser import Browser

CANVAS = "document.querySelector('canvas')"
NOTICE = "document.querySelector('.mantine-Notification-closeButton')"
LONG = 120.0  # s, on a computer that has much else to do
SMALL = 860, 420  # px: every pixel is drawn by the processor
SLIDER = "[...document.querySelectorAll('[role=slider]')]"


@pytest.fixture(scope="module")
def studio(kang: CompiledModel) -> Iterator[Studio]:
    with Studio(kang) as opened:
        yield opened


@pytest.fixture(scope="module")
def opened(studio: Studio, browser: Browser) -> Browser:
    """The page as a person has it who follows the address in the terminal."""
    browser.open(studio.address, SMALL[0], height=SMALL[1])
    browser.driver.set_script_timeout(LONG)
    browser.wait(f"{CANVAS} && document.body.textContent.includes('ellipsoid')", LONG)
    assert arrived(lambda: bool(studio._server.get_clients()), LONG)
    browser.wait(NOTICE, LONG)  # of WebGL without a graphics card, in front of the arm
    browser.run(f"{NOTICE}.click()")
    browser.wait(f"!{NOTICE}")
    return browser


def seen(studio: Studio, browser: Browser, place: np.ndarray) -> np.ndarray:
    """Where a place (3,) in m is in the window, (2,) in px: a pinhole camera."""
    camera = next(iter(studio._server.get_clients().values())).camera
    box = browser.run(f"const box = {CANVAS}.getBoundingClientRect(); return [box.left, box.top, box.width, box.height]")
    forward = camera.look_at - camera.position
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, camera.up_direction)
    right = right / np.linalg.norm(right)
    away = place - camera.position
    scale = box[3] / (2 * np.tan(camera.fov / 2) * (away @ forward))
    return np.array([box[0] + box[2] / 2 + scale * (away @ right), box[1] + box[3] / 2 - scale * (away @ np.cross(right, forward))])


def test_the_page_opens_and_asks_nobody_else(opened: Browser, studio: Studio) -> None:
    """Address without the token, no errors, all it loads is from here."""
    assert opened.run("return location.href") == f"http://127.0.0.1:{studio._server.get_port()}/"
    assert "No limit binds" in opened.run("return document.body.textContent")
    assert not [line for line in opened.messages() if line.startswith("SEVERE")]
    assert not [url for url in opened.requests() if not url.startswith(("http://127.0.0.1", "blob:", "data:"))]
    refused = "try { await fetch('https://example.com/'); return 'let through' } catch (error) { return 'refused' }"
    assert opened.driver.execute_async_script(f"(async () => {{{refused}}})().then(arguments[0])") == "refused"
    assert "Content Security Policy" in opened.messages()[0]


@pytest.mark.slow
def test_without_the_token_there_is_nothing(opened: Browser, studio: Studio) -> None:
    """In a tab that has no cookie: the same server, plain refusal; the tab with the page goes on."""
    opened.driver.switch_to.new_window("tab")
    address = studio.address.partition("?")[0].replace("127.0.0.1", "localhost")  # cookies are another name's
    opened.driver.get(address)
    assert opened.run("return document.body.textContent").startswith("403: the address that the terminal shows")
    opened.driver.close()
    opened.driver.switch_to.window(opened.driver.window_handles[0])
    opened.messages()


@pytest.mark.slow
def test_the_mouse_drags_the_tip(opened: Browser, studio: Studio, tmp_path: Path) -> None:
    """Along the red arrow: the arm follows along x, the gizmo is at the tip, the panel says so; blue pixels move along, too."""
    before = studio.arm.point.held.tip
    length = studio.arm._gizmo.scale
    start, end = (seen(studio, opened, before + np.array([x, 0.0, 0.0])) for x in (0.8 * length, 0.8 * length + 0.10))
    first = blue(opened.screenshot(tmp_path / "before.png", whole=False))
    opened.drag((float(start[0]), float(start[1])), (float(end[0]), float(end[1])), steps=6)
    assert arrived(lambda: bool(np.linalg.norm(studio.arm.point.held.tip - before) > 0.05))
    assert studio.settle()
    moved = studio.arm.point.held.tip - before
    assert moved[0] == pytest.approx(0.10, abs=0.02)
    np.testing.assert_allclose(moved[1:], 0.0, atol=1e-3)
    assert studio.arm.point.asked is not None
    assert studio.arm.point.asked.solved
    opened.wait("document.body.textContent.includes('reached')")
    second = blue(opened.screenshot(tmp_path / "after.png", whole=False))
    assert second > first + 10


@pytest.mark.slow
def test_keys_move_a_slider(opened: Browser, studio: Studio) -> None:
    """The first pressure's thumb takes the focus; each arrow key is a step of 0.5 kPa, and the arm follows."""
    place = next(k for k in range(len(opened.run(f"return {SLIDER}"))) if opened.run(f"return {SLIDER}[{k}].ariaValueMax") == "500")
    before = studio.arm.point.held.inputs[0]
    opened.run(f"{SLIDER}[{place}].focus()")
    opened.press(*["ARROW_RIGHT"] * 5)
    assert arrived(lambda: bool(studio.arm.point.held.inputs[0] > before + 2e3))
    assert studio.settle()
    assert studio.arm.point.asked is None
    assert studio.arm.point.held.inputs[0] == pytest.approx(before + 2.5e3, abs=600)


def arrived(condition: Callable[[], bool], seconds: float = 60.0) -> bool:
    """Whether it came true in time."""
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.05)
    return condition()


def blue(picture: Path) -> float:
    """Mean column of what is as blue as muscles and their ellipsoid, in px."""
    pixels = np.asarray(Image.open(picture).convert("RGB"), dtype=int)[:, : SMALL[0] - 400]
    assert PRESSURE[2] > 2 * PRESSURE[1]
    found = (pixels[..., 2] > pixels[..., 0] + 40) & (pixels[..., 2] > pixels[..., 1] + 10)
    assert found.any()
    return float(np.nonzero(found)[1].mean())

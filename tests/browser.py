"""Pages in headless Chromium, as a reader meets them: what sticks out, what cannot be read, what a keyboard does not reach.

Selenium drives the system's Chromium through the driver that comes with it (Debian: `chromium chromium-driver`); nothing is downloaded.
"""

from __future__ import annotations

import base64
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

PHONE, DESK = 390, 1280  # px
CONTRAST = 4.5  # WCAG 2.2, 1.4.3, level AA
MOST_STOPS = 400  # of the Tab key on a page

SEEN = """
const shown = e => e.checkVisibility({opacityProperty: true, visibilityProperty: true}) && e.getClientRects().length > 0;
const called = e => e.tagName.toLowerCase() + (e.id ? '#' + e.id : '') + ' ' + JSON.stringify((e.textContent || '').trim().slice(0, 40));
"""
STICKING_OUT = (
    SEEN
    + """
const width = arguments[0], out = [];
if (document.documentElement.scrollWidth > width) {
  const inside = e => { for (let p = e.parentElement; p; p = p.parentElement)
    if (p !== document.body && p !== document.documentElement && getComputedStyle(p).overflowX !== 'visible') return true; return false; };
  for (const e of document.body.querySelectorAll('*'))
    if (shown(e) && e.getBoundingClientRect().right > width + 0.5 && !inside(e)) out.push(called(e));
  if (!out.length) out.push('the page: ' + document.documentElement.scrollWidth + ' px');
}
return out;
"""
)
PALE = (
    SEEN
    + """
const least = arguments[0], ctx = new OffscreenCanvas(1, 1).getContext('2d', {willReadFrequently: true}), known = {};
const rgba = text => known[text] ??= (() => { ctx.clearRect(0, 0, 1, 1); ctx.fillStyle = text; ctx.fillRect(0, 0, 1, 1);
  const d = ctx.getImageData(0, 0, 1, 1).data; return [d[0], d[1], d[2], d[3] / 255]; })();
const over = (top, under) => { const a = top[3]; return [0, 1, 2].map(k => a * top[k] + (1 - a) * under[k]).concat(1); };
const probe = document.body.appendChild(document.createElement('i')); probe.style.background = 'Canvas';
const canvas = rgba(getComputedStyle(probe).backgroundColor); probe.remove();
const behind = e => { const layers = []; for (let p = e; p; p = p.parentElement) layers.unshift(getComputedStyle(p).backgroundColor);
  return layers.reduce((under, colour) => over(rgba(colour), under), canvas); };
const opacity = e => { let all = 1; for (let p = e; p; p = p.parentElement) all *= parseFloat(getComputedStyle(p).opacity); return all; };
const light = c => { const l = c.slice(0, 3).map(v => (v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
  return 0.2126 * l[0] + 0.7152 * l[1] + 0.0722 * l[2]; };
const out = [], walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
while (walk.nextNode()) {
  const e = walk.currentNode.parentElement;
  if (!walk.currentNode.textContent.trim() || e.closest('script, style, title, desc') || !shown(e)) continue;
  const style = getComputedStyle(e), under = behind(e), ink = rgba(e instanceof SVGElement ? style.fill : style.color).slice();
  ink[3] *= opacity(e);
  const [a, b] = [light(over(ink, under)), light(under)].sort((x, y) => y - x), ratio = (a + 0.05) / (b + 0.05);
  if (ratio < least) out.push(ratio.toFixed(2) + ' ' + called(e));
}
return out;
"""
)
INTERACTIVE = (
    SEEN
    + """
const chosen = 'a[href], button, input, select, textarea, summary, [tabindex]:not([tabindex="-1"])';
const off = e => e.disabled || e.type === 'hidden' || (e.type === 'radio' && !e.checked);
const scrolls = e => ['auto', 'scroll'].includes(getComputedStyle(e).overflowX) && e.scrollWidth > e.clientWidth + 1;
return [...document.body.querySelectorAll('*')].filter(e => shown(e) && ((e.matches(chosen) && !off(e)) || scrolls(e)));
"""
)
FOCUS = """
const e = document.activeElement;
if (!e || e === document.body || e === document.documentElement) return null;
const s = getComputedStyle(e);
return [e, (s.outlineStyle !== 'none' && parseFloat(s.outlineWidth) > 0) || s.boxShadow !== 'none'];
"""


class Browser:
    """An open browser with one page.

    Attributes:
        driver: Selenium's, for what is not here.
        width: of the window in px.
    """

    def __init__(self, driver: Any) -> None:
        self.driver, self.width = driver, DESK

    def open(self, address: str | Path, width: int = DESK, dark: bool = False, height: int = 900) -> Browser:
        """Load an address or a file, in a window of that size and light or dark."""
        self.driver.get("about:blank")  # the page before has nothing more to say
        self.messages()
        self.width = width
        self.command("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        self.media(dark)
        self.driver.get(address.resolve().as_uri() if isinstance(address, Path) else address)
        return self

    def media(self, dark: bool = False, print_: bool = False) -> None:
        """Show the page light or dark, or as it is printed."""
        features = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.command("Emulation.setEmulatedMedia", media="print" if print_ else "", features=features)

    def command(self, name: str, **arguments: Any) -> Any:
        """Send a command of the DevTools protocol."""
        return self.driver.execute_cdp_cmd(name, arguments)

    def run(self, script: str, *arguments: Any) -> Any:
        """Run JavaScript, which answers by `return`."""
        return self.driver.execute_script(script, *arguments)

    def wait(self, condition: str, seconds: float = 30.0) -> None:
        """Wait until a JavaScript expression is true."""
        from selenium.webdriver.support.wait import WebDriverWait

        WebDriverWait(self.driver, seconds, 0.05).until(lambda _: self.run(f"return Boolean({condition})"), condition)

    def press(self, *keys: str) -> None:
        """Press keys one after another where the focus is; names as in Selenium's `Keys`, or characters."""
        from selenium.webdriver import ActionChains, Keys

        for key in keys:
            ActionChains(self.driver, duration=0).send_keys(getattr(Keys, key, key)).perform()

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 8) -> None:
        """Drag with the left button from one place of the window to another, in px."""

        def mouse(kind: str, part: float) -> None:
            x, y = (a + part * (b - a) for a, b in zip(start, end, strict=True))
            self.command("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)

        mouse("mousePressed", 0.0)
        for step in range(1, steps + 1):
            mouse("mouseMoved", step / steps)
        mouse("mouseReleased", 1.0)

    def screenshot(self, path: Path, whole: bool = True) -> Path:
        """Write what is seen as PNG, the whole page or the window."""
        more: dict[str, Any] = {}
        if whole:
            size = self.command("Page.getLayoutMetrics")["cssContentSize"]
            clip = {"x": 0, "y": 0, "width": self.width, "height": size["height"], "scale": 1}
            more = {"captureBeyondViewport": True, "clip": clip}
        path.write_bytes(base64.b64decode(self.command("Page.captureScreenshot", format="png", **more)["data"]))
        return path

    def messages(self) -> list[str]:
        """What the console was told since this was asked last, errors of scripts and of loading among it."""
        return [f"{entry['level']}: {entry['message']}" for entry in self.driver.get_log("browser")]

    def requests(self) -> list[str]:
        """Addresses that the page has asked for besides its own; data in the page are none."""
        return self.run("return performance.getEntriesByType('resource').map(entry => entry.name)")

    def sticking_out(self) -> list[str]:
        """Elements wider than the window, which make the page scroll sideways; what scrolls inside a box does not."""
        return self.run(STICKING_OUT, self.width)

    def pale(self, least: float = CONTRAST) -> list[str]:
        """Visible texts with less contrast than this against what is behind them, by WCAG's formula; text in images is not seen."""
        return self.run(PALE, least)

    def unnamed_images(self) -> list[str]:
        """Images, and drawings that say they are one, without an alternative text."""
        text = "(e.getAttribute('alt') || e.getAttribute('aria-label') || '').trim()"
        chosen = "document.querySelectorAll('img, svg[role], canvas, [role=img]')"
        return self.run(f"return [...{chosen}].filter(e => !e.closest('[aria-hidden=true]') && !{text}).map(e => e.outerHTML.slice(0, 80))")

    def unreached(self) -> list[str]:
        """Interactive elements and scrolling boxes that Tab does not come to, or where nobody sees that it has."""
        self.run("document.activeElement && document.activeElement.blur(); getSelection().removeAllRanges(); scrollTo(0, 0)")
        reached: list[Any] = []
        faint: list[Any] = []
        for _ in range(MOST_STOPS):
            self.press("TAB")
            focused = self.run(FOCUS)
            if focused is None or focused[0] in reached:
                break
            reached.append(focused[0])
            faint += [focused[0]] * (not focused[1])
        name = "return arguments[0].outerHTML.slice(0, 80)"
        missed = [f"not reached: {self.run(name, each)}" for each in self.run(INTERACTIVE) if each not in reached]
        return missed + [f"focus not seen: {self.run(name, each)}" for each in faint]

    def check(self, keyboard: bool = True) -> None:
        """Assert what holds for every page: nothing sticks out, is told, is pale, has no name or, where asked, is out of Tab's reach."""
        found = {
            "sticking out": self.sticking_out(),
            "console": self.messages(),
            "pale": self.pale(),
            "unnamed images": self.unnamed_images(),
            "keyboard": self.unreached() if keyboard else [],
        }
        assert not any(found.values()), {name: entries for name, entries in found.items() if entries}


@contextmanager
def chromium() -> Iterator[Browser]:
    """Open headless Chromium; the test is skipped where it is missing."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed (extra test)")
    program, driver = (
        next(filter(None, map(shutil.which, names)), None) for names in (("chromium", "chromium-browser"), ("chromedriver",))
    )
    if not (program and driver):
        pytest.skip("Chromium or its driver is missing (Debian: chromium chromium-driver)")
    options = webdriver.ChromeOptions()
    options.binary_location = program
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    arguments = ["--headless=new", "--hide-scrollbars", "--disable-gpu", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage"]
    for argument in arguments + ["--no-sandbox"] * (os.name == "posix" and os.geteuid() == 0):
        options.add_argument(argument)
    opened = webdriver.Chrome(options, webdriver.ChromeService(driver))
    try:
        yield Browser(opened)
    finally:
        opened.quit()

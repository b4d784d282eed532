"""Make the screenshots of docs/images in headless Chromium: `python -m docs.screenshots [FOLDER]`, from the repository's root.

What is shown is computed first, in FOLDER (else a temporary one), by README's and the tutorial's commands; what is there already is kept:
the demo, the data set of the tutorial's machine, which carries what its model does not know, the verdict on it. Minutes on two cores.
"""

from __future__ import annotations

import io
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from selenium.webdriver import Keys

from tepm_opt.models.compile import compile_model
from tepm_opt.studio.page import Studio
from tepm_opt.studio.recordings import open_recordings
from tests.browser import DESK, PHONE, Browser, chromium
from tests.docs.texts import ROOT, steps

IMAGES = ROOT / "docs" / "images"
LARGEST = 150_000  # bytes of a picture
COLORS = (256, 128, 64, 32)  # of its palette: the most that its size allows
DESK_HEIGHT, PHONE_HEIGHT = 860, 844  # px
STUDIO_SIZE = 1280, 800  # px

TUTORIAL = ROOT / "docs" / "tutorial.md"
MACHINE = ("tepm hw rig new", "tepm rig new", "sed ", "cat ", "tepm record")  # how the tutorial's commands begin that make its data
VERDICT = ("tepm discrepancy",)
TEPM = f'tepm() {{ "{sys.executable}" -m tepm_opt "$@"; }}'

FAR = np.array([0.26, 0.10, 0.37])  # m, out of the arm's reach
LONG, DRAWN = 120.0, 5.0  # s: for what a processor without a graphics card draws, and until its last frame is there
CANVAS = "document.querySelector('canvas')"
NOTICE = "document.querySelector('.mantine-Notification-closeButton')"


def prepare(folder: Path) -> None:
    """Compute what is not there yet.

    Raises:
        CalledProcessError: a command failed.
    """
    told = [step.text for step in steps(TUTORIAL)]
    commands = {
        "demo": ["tepm demo --out demo"],
        "bench": [text for text in told if text.startswith(MACHINE)],
        "found": [text for text in told if text.startswith(VERDICT)],
    }
    for name, texts in commands.items():
        if not (folder / name).exists():
            for text in texts:
                subprocess.run(["bash", "-c", f"{TEPM}\n{text}"], cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)}, check=True)


def shrunk(picture: Image.Image) -> bytes:
    """A picture as PNG with as many colours as fit into a small file.

    Raises:
        RuntimeError: not even few colours make it small.
    """
    for colors in COLORS:
        small = io.BytesIO()
        picture.convert("RGB").quantize(colors, dither=Image.Dither.NONE).save(small, "PNG", optimize=True)
        if small.tell() <= LARGEST:
            return small.getvalue()
    raise RuntimeError(f"{picture.size} px: more than {LARGEST} bytes with {COLORS[-1]} colours")


def pages(browser: Browser, folder: Path) -> Iterator[str]:
    """Open the pages as they are shown, the name of a picture each."""
    demo, report = folder / "demo" / "index.html", folder / "found" / "report.html"
    browser.open(demo, DESK, height=DESK_HEIGHT)
    yield "page_demo"
    browser.open(demo, PHONE, dark=True, height=PHONE_HEIGHT)
    yield "page_demo_phone"
    browser.open(report, DESK, dark=True, height=DESK_HEIGHT)
    yield "page_verdict"
    browser.open(report, DESK, height=DESK_HEIGHT)
    browser.run("const tip = document.querySelector('[data-of=tip]'); tip.scrollIntoView(); tip.querySelector('svg.plot').focus()")
    browser.press(*["ARROW_RIGHT"] * 5)
    yield "page_curves"


def studio(browser: Browser, folder: Path) -> Iterator[str]:
    """Open the studio: an arm dragged out of reach within its workspace, and a run beside the model as it was known."""
    with Studio(compile_model("kang2017")) as page:
        opened(browser, page)
        beside(browser, "workspace", "checkbox").click()
        page.worker.ask("arm", lambda: page.arm.drag(FAR))
        drawn(browser, page, "out of reach")
        yield "studio_arm"
    recordings = open_recordings(folder / "found")
    with Studio(compile_model(next(iter(recordings.models.values()))), recordings) as page:
        opened(browser, page)
        drawn(browser, page, "rms of the run")
        typed(browser, "time, s", "12")
        typed(browser, "arrows ×", "2")
        drawn(browser, page, "12.00 s")
        yield "studio_verdict"


def opened(browser: Browser, page: Studio) -> None:
    """Open the studio's page, without the browser's word on its missing graphics card."""
    browser.open(page.address, STUDIO_SIZE[0], height=STUDIO_SIZE[1])
    browser.wait(NOTICE, LONG)
    browser.run(f"{NOTICE}.click()")
    browser.wait(f"{CANVAS} && !{NOTICE}", LONG)


def beside(browser: Browser, label: str, kind: str) -> Any:
    """The field of a kind, as HTML calls it, that stands beside a label in the studio's panel."""
    return browser.driver.find_element("xpath", f"//label[normalize-space()='{label}']/following::input[@type='{kind}'][1]")


def typed(browser: Browser, label: str, value: str) -> None:
    """Type a number beside a slider of the studio's panel."""
    beside(browser, label, "text").send_keys(Keys.CONTROL, "a", Keys.NULL, value, Keys.ENTER)


def drawn(browser: Browser, page: Studio, said: str) -> None:
    """Wait until the studio has solved, told and drawn what was asked for."""
    page.settle()
    browser.wait(f"document.body.textContent.includes('{said}')", LONG)
    time.sleep(DRAWN)


def make(folder: Path) -> None:
    """Make all pictures from a folder of results, and what is missing in it."""
    prepare(folder)
    with chromium() as browser, tempfile.TemporaryDirectory() as raw:
        for shown in (pages, studio):
            for name in shown(browser, folder):
                shot = browser.screenshot(Path(raw) / f"{name}.png", whole=False)
                (IMAGES / f"{name}.png").write_bytes(shrunk(Image.open(shot)))
    (IMAGES / "circle.png").write_bytes(shrunk(Image.open(folder / "demo" / "ik.png")))


def main() -> None:
    """Make the pictures from the folder that is named, or a temporary one."""
    if len(sys.argv) > 1:
        folder = Path(sys.argv[1])
        folder.mkdir(parents=True, exist_ok=True)
        make(folder)
    else:
        with tempfile.TemporaryDirectory() as made:
            make(Path(made))


if __name__ == "__main__":
    main()

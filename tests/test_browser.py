"""What the checks of pages see, on pages made to fail each of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.browser import DESK, PHONE, Browser

HEAD = "<!doctype html><html lang=en><meta name=viewport content='width=device-width'><title>t</title><style>:root{color-scheme:light dark}"
GOOD = "<p>Words</p><img alt='a dot' src='data:image/gif;base64,R0lGODlhAQABAAAAACw='><button>press</button>"


def opened(browser: Browser, folder: Path, style: str, body: str, width: int = PHONE, dark: bool = False) -> Browser:
    path = folder / "page.html"
    path.write_text(f"{HEAD}{style}</style>{body}", encoding="utf-8")
    return browser.open(path, width, dark)


@pytest.mark.parametrize("dark", [False, True])
def test_a_good_page_passes(browser: Browser, tmp_path: Path, dark: bool) -> None:
    opened(browser, tmp_path, "", GOOD, dark=dark).check()
    assert browser.requests() == []


def test_what_sticks_out(browser: Browser, tmp_path: Path) -> None:
    wide = "<div style='width:600px'>wide</div>"
    assert opened(browser, tmp_path, "", GOOD + wide).sticking_out() == ['div "wide"']
    assert not opened(browser, tmp_path, "", GOOD + wide, DESK).sticking_out()
    assert not opened(browser, tmp_path, "", f"<div style='overflow-x:auto'>{wide}</div>").sticking_out()


def test_what_the_console_is_told(browser: Browser, tmp_path: Path) -> None:
    assert "missing is not defined" in opened(browser, tmp_path, "", "<script>missing()</script>").messages()[0]
    assert "nothing.png" in opened(browser, tmp_path, "", "<img alt=a src=nothing.png>").messages()[0]
    assert opened(browser, tmp_path, "", GOOD).messages() == []


@pytest.mark.parametrize(("ink", "ratio"), [("#767676", None), ("#777777", "4.48"), ("#0000ff80", "3.29"), ("color(srgb 1 1 0)", "1.07")])
def test_contrast_on_white(browser: Browser, tmp_path: Path, ink: str, ratio: str | None) -> None:
    """#767676 is WCAG's known limit on white; the others by the formula, alpha mixed with what is behind."""
    found = opened(browser, tmp_path, f"body{{background:#fff}} p{{color:{ink}}}", "<p>Words</p>").pale()
    assert found == ([] if ratio is None else [f'{ratio} p "Words"'])


@pytest.mark.slow
def test_contrast_by_layers(browser: Browser, tmp_path: Path) -> None:
    """White on white stays dark on a dark canvas; a panel hides it; pale through opacity; an SVG's ink is its fill."""
    style = "p{color:#eee} div{background:#000}"
    assert opened(browser, tmp_path, style, "<p>a</p>", dark=True).pale() == []
    assert opened(browser, tmp_path, style, "<p>a</p>").pale() == ['1.16 p "a"']
    assert opened(browser, tmp_path, style, "<div><p>a</p></div>").pale() == []
    assert len(opened(browser, tmp_path, style, "<div><p style='opacity:.4'>a</p></div>").pale()) == 1
    assert len(opened(browser, tmp_path, "", "<svg><text y=20 fill=yellow>a</text></svg>").pale()) == 1


def test_images_without_words(browser: Browser, tmp_path: Path) -> None:
    assert len(opened(browser, tmp_path, "", GOOD.replace("a dot", " ") + "<svg role=img></svg>").unnamed_images()) == 2


@pytest.mark.slow
def test_what_the_keyboard_misses(browser: Browser, tmp_path: Path) -> None:
    assert opened(browser, tmp_path, "", "<a href='#x'>link</a>" + GOOD).unreached() == []
    body = "<span role=button tabindex=0>seen</span><button tabindex=-1 id=b>not</button>"
    assert opened(browser, tmp_path, "span:focus{outline:none}", body).unreached() == [
        'not reached: <button tabindex="-1" id="b">not</button>',
        'focus not seen: <span role="button" tabindex="0">seen</span>',
    ]


def test_drag_keys_and_print(browser: Browser, tmp_path: Path) -> None:
    script = "<script>onmousemove=e=>window.at=[e.clientX,e.buttons];onkeydown=e=>window.key=e.key</script>"
    opened(browser, tmp_path, "@media print{p{color:red}}", GOOD + script)
    browser.drag((10.0, 10.0), (200.0, 50.0))
    browser.press("ARROW_LEFT")
    assert browser.run("return [at, key]") == [[200, 1], "ArrowLeft"]
    browser.media(print_=True)
    assert browser.run("return getComputedStyle(document.querySelector('p')).color") == "rgb(255, 0, 0)"
    assert browser.screenshot(tmp_path / "page.png").read_bytes().startswith(b"\x89PNG")

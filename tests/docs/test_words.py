"""Documents are plain; names and docstrings get plainer: their number of bare participles and riddles may only fall."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.docs.texts import ROOT
from tests.docs.words import bare_names, measure_sentences, riddles

README = ROOT / "README.md"
PAGES = sorted((ROOT / "docs").rglob("*.md"))
MOST_BARE_NAMES, MOST_RIDDLES = 0, 0
"""In the package; who lowers the number lowers it here."""


def test_the_readme_is_one_screen() -> None:
    text = README.read_text(encoding="utf-8")
    found = measure_sentences(text)
    assert len(text.split()) <= 900
    assert text.count("\n") <= 120
    assert found.mean <= 13
    assert found.long_share <= 0.05


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_a_page_has_short_sentences(page: Path) -> None:
    found = measure_sentences(page.read_text(encoding="utf-8"))
    assert found.mean <= 14
    assert found.long_share <= 0.08


def test_bare_names_and_riddles_only_fall() -> None:
    code = [path.read_text(encoding="utf-8") for path in sorted((ROOT / "tepm_opt").rglob("*.py"))]
    bare, puzzling = ([one for module in code for one in kind(module)] for kind in (bare_names, riddles))
    assert len(bare) == MOST_BARE_NAMES, "one more is a name to choose anew; fewer: lower the limit"
    assert len(puzzling) == MOST_RIDDLES, "one more is a docstring to write anew; fewer: lower the limit"


def test_what_is_measured() -> None:
    text = "# A title of many words\n\nOne two three. Four five `six seven` eight: nine ten eleven.\n\n| a | table |\n\n- an item here\n"
    assert measure_sentences(text).lengths == (3, 4, 3, 3)
    assert measure_sentences(f"{'word ' * 26}.").long_share == 1.0
    code = '@property\ndef told(self): ...\ndef told():\n    """What it is."""\ndef read():\n    """Of a file."""\ndef _between(): ...\n'
    assert list(bare_names(code)) == ["told", "_between"]
    assert riddles(code) == ["What it is.", "Of a file."]

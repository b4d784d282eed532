"""The documentation's site: built without a warning, nothing from elsewhere, and pages that say what the program has."""

from __future__ import annotations

import json
import re
from importlib.util import find_spec
from pathlib import Path

import casadi as ca
import pytest

from tepm_opt.models.effects import effects
from tepm_opt.models.model import Model
from tests.docs.texts import ROOT

if lacking := [name for name in ("sphinx", "myst_parser", "furo", "latex2mathml") if find_spec(name) is None]:
    pytest.skip(f"not installed: {', '.join(lacking)} (extra docs)", allow_module_level=True)

from docs.site import commands, names, notebooks, pages
from docs.site.equations import Hooks, tex

FOREIGN = re.compile(
    r'<(?:script|img|iframe)[^>]*\ssrc="(?:https?:)?//|<link[^>]*rel="stylesheet"[^>]*href="(?:https?:)?//|@import|url\(["\']?https?:'
)


@pytest.mark.slow
def test_builds_without_a_warning_and_fetches_nothing(tmp_path: Path) -> None:
    from docs.site.__main__ import build

    assert build(tmp_path) == 0
    html = {path.relative_to(tmp_path).as_posix(): path.read_text(encoding="utf-8") for path in tmp_path.rglob("*.html")}
    assert {f"effects/{effect.name}.html" for effect in effects()} <= html.keys()
    assert {f"notebooks/{name}.html" for name in notebooks.NAMES} <= html.keys()
    assert [name for name, text in html.items() if FOREIGN.search(text)] == []
    assert [path.name for path in tmp_path.rglob("*.css") if FOREIGN.search(path.read_text(encoding="utf-8"))] == []
    assert html["explanation/theory.html"].count('<span class="number"') == 22
    assert "<math" in html["effects/payload.html"]
    assert all("merror" not in text for text in html.values())


def test_contents_have_every_page_of_docs() -> None:
    listed = {page for section in pages.CONTENTS.values() for page in section}
    assert {path.relative_to(ROOT / "docs").with_suffix("").as_posix() for path in (ROOT / "docs").rglob("*.md")} - listed == set()


def test_every_command_and_its_options_are_told() -> None:
    page = commands.page()
    for path, option in (("tepm ik", "--mid-tension"), ("tepm data import", "--map"), ("tepm hw check", ""), ("tepm hw rig new", "--from")):
        section = page.partition(f"\n## {path}\n")[2].partition("\n## ")[0]
        assert section
        assert option in section


def test_every_name_of_the_stub_is_told() -> None:
    listed = [name for each in names.names().values() for name in each]
    stubs = "".join((ROOT / "tepm_opt" / path / "__init__.pyi").read_text(encoding="utf-8") for path in ("", "studies"))
    assert len(listed) == stubs.count("\nfrom .") > 100
    assert {"solvers.mechanics.statics.solve_statics", "errors.InputError", "studies.blind.run.run_blind"} <= set(listed)


def test_equations_are_those_of_the_code() -> None:
    """By hand, of effects whose formula is known."""
    written = {effect.name: dict(Hooks(effect, Model.from_robot("kang2017")).equations()) for effect in effects()}
    assert r"m_n' = m + \frac{\mathrm{mass}}{3}" in written["payload"].values()
    assert r"p_{13}' = \left(1 - \mathrm{loss}\right) \, p_{13}" in written["actuator_gain"].values()
    assert r"k' = k \, \left(1 + \mathrm{stiffening}\right)" in written["rigid_plates"].values()
    assert all(any(equations.values()) or equations for equations in written.values())


@pytest.mark.parametrize(
    ("expression", "text"),
    [
        (lambda a, b: a - (b - a), r"a - \left(b - a\right)"),
        (lambda a, b: (a + b) * a, r"\left(a + b\right) \, a"),
        (lambda a, b: ca.if_else(a > b, a, 2 * b), r"\begin{cases} a & b < a \\ 2 \, b & \text{otherwise} \end{cases}"),
        (lambda a, b: ca.sqrt(a) / ca.exp(b), r"\frac{\sqrt{a}}{e^{b}}"),
        (lambda a, b: -(a + b), r"-\left(a + b\right)"),
    ],
)
def test_terms_are_written_as_one_would(expression: object, text: str) -> None:
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    assert tex(expression(a, b), {"a": "a", "b": "b"}) == text  # type: ignore[operator]


def test_pages_of_the_root_lose_the_folder() -> None:
    assert (
        pages.from_root("![x](docs/images/a.png) `docs/how-to/control.md`")
        == "![x](images/a.png) [`docs/how-to/control.md`](how-to/control.md)"
    )


def test_links_to_notebooks_lead_to_their_pages() -> None:
    assert pages.to_notebooks("[a](../notebooks/03_x.ipynb), [`b`](notebooks/04.ipynb)") == "[a](notebooks/03_x.md), [`b`](notebooks/04.md)"


def test_every_notebook_is_a_page_with_its_words_code_and_figures() -> None:
    written = notebooks.pages()
    assert {path.stem for path in (ROOT / "notebooks").glob("*.ipynb")} == set(notebooks.NAMES)
    for name in notebooks.NAMES:
        page = written[f"notebooks/{name}.md"]
        assert isinstance(page, str)
        cells = json.loads((ROOT / "notebooks" / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
        assert [cell["id"] for cell in cells if cell["cell_type"] == "code" and "".join(cell["source"]) not in page] == []
        printed = [
            "".join(output["text"]).strip() for cell in cells for output in cell.get("outputs", []) if output["output_type"] == "stream"
        ]
        assert [text for text in printed if text not in page] == []
        shown = re.findall(r"^!\[Figure \d+: .+\]\((.+)\)$", page, re.M)
        assert len(shown) == sum("image/png" in output.get("data", {}) for cell in cells for output in cell.get("outputs", []))
        assert all(written[f"notebooks/{figure}"][:4] == b"\x89PNG" for figure in shown)

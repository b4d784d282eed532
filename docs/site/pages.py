"""All pages of the site, put into a folder for Sphinx: those of docs/ as they are, those of the root, and those that are made."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from docs.site import commands, effects, names, notebooks

ROOT = Path(__file__).resolve().parents[2]
FROM_ROOT = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
"""Files of the repository's root, and the pages they are on the site."""

CONTENTS: dict[str, tuple[str, ...]] = {
    "Tutorial": ("tutorial", *(f"notebooks/{name}" for name in notebooks.NAMES)),
    "How to": tuple(
        f"how-to/{name}"
        for name in (
            "choose",
            "own_robot",
            "control",
            "recording",
            "importing",
            "discrepancy",
            "what_changed",
            "any_machine",
            "bench",
            "hardware",
            "trackers",
            "ros2",
            "studio",
            "pages",
            "exporting",
        )
    ),
    "Reference": (
        "reference/commands",
        "reference/files",
        "reference/command_line",
        "reference/glossary",
        "effects/index",
        *(f"api/{name}" for name in names.TITLES),
    ),
    "Explanation": tuple(f"explanation/{name}" for name in ("theory", "mpc", "verdict", "safety", "architecture", "comparison")),
    "Results": tuple(
        f"results/{name}"
        for name in ("control", "faults", "verdicts", "blind", "paper", "other_robots", "measured", "speed", "convergence")
    ),
    "Take part": ("contributing", "changelog"),
}
"""The site's contents: pages by section, in the order in which one needs them."""


def write(folder: Path) -> None:
    """Write all pages, and what they show, into a folder."""
    docs = ROOT / "docs"
    for path in (*docs.rglob("*.md"), *docs.glob("*.toml")):
        _write(folder / path.relative_to(docs), to_notebooks(path.read_text(encoding="utf-8")))
    shutil.copytree(docs / "images", folder / "images")
    for source, page in FROM_ROOT.items():
        _write(folder / page, to_notebooks(from_root((ROOT / source).read_text(encoding="utf-8"))))
    with (folder / "index.md").open("a", encoding="utf-8") as index:
        index.write(contents())
    _write(folder / "reference" / "command_line.md", commands.page())
    for name, page in {**names.pages(), **effects.pages(), **notebooks.pages()}.items():
        _write(folder / name, page)


def to_notebooks(text: str) -> str:
    """A page whose links to notebooks lead to their pages."""
    return re.sub(r"\]\((?:\.\./)?((?:\.\./)*)notebooks/(\w+)\.ipynb\)", r"](\1notebooks/\2.md)", text)


def from_root(text: str) -> str:
    """A page of the root as one of docs/: links to docs/ lose it, and a page or notebook that is only named is a link."""
    text = text.replace("](docs/", "](")
    for source, page in FROM_ROOT.items():
        text = text.replace(f"]({source})", f"]({page})")
    return re.sub(r"(?<!\[)`docs/([\w/-]+\.md)`", r"[`docs/\1`](\1)", text)


def contents() -> str:
    """What Sphinx makes the sidebar from."""
    section = "\n```{{toctree}}\n:caption: {}\n:hidden:\n\n{}\n```\n"
    return "".join(section.format(title, "\n".join(pages)) for title, pages in CONTENTS.items())


def _write(path: Path, content: str | bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())

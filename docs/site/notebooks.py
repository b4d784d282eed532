"""Pages of the notebooks: their words, their code, and what it showed when they were stored. Nothing is run."""

from __future__ import annotations

import json
import re
from base64 import b64decode
from collections.abc import Iterator
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parents[2] / "notebooks"
NAMES = tuple(sorted(path.stem for path in FOLDER.glob("*.ipynb")))
TABLE = 120
"""Characters that a printed table is wide at most."""


def pages() -> dict[str, str | bytes]:
    """A page for each notebook, with the notebook itself to be taken home, and all figures."""
    found: dict[str, str | bytes] = {}
    for name in NAMES:
        content = (FOLDER / f"{name}.ipynb").read_text(encoding="utf-8")
        figures: dict[str, bytes] = {}
        text = "\n\n".join(_blocks(name, json.loads(content)["cells"], figures))
        found[f"notebooks/{name}.md"] = f"{text}\n\nTo run it: [{name}.ipynb]({name}.ipynb).\n"
        found[f"notebooks/{name}.ipynb"] = content
        found |= {f"notebooks/{figure}": picture for figure, picture in figures.items()}
    return found


def _blocks(name: str, cells: list[dict[str, Any]], figures: dict[str, bytes]) -> Iterator[str]:
    """Markdown of all cells, one after the other; figures are put beside it under the notebook's name and their number."""
    heading = ""
    for cell in cells:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            heading = (re.findall(r"^#+ (.+)$", source, re.M) or [heading])[-1]
            yield re.sub(r"`docs/([\w/-]+\.md)`", r"[`docs/\1`](../\1)", source)
            continue
        yield f"```python\n{source}\n```"
        for output in cell["outputs"]:
            shown = output.get("data", {})
            if "image/png" in shown:
                figure = f"{name}_{len(figures) + 1}.png"
                figures[figure] = b64decode("".join(shown["image/png"]))
                yield f"![Figure {len(figures)}: {heading}]({figure})"
            else:
                yield _printed("".join(output.get("text") or shown["text/plain"]).rstrip())


def _printed(text: str) -> str:
    """A block of what was printed: sentences are wrapped, tables scroll."""
    kind = "{code-block} text\n:class: sentences\n" if max(map(len, text.splitlines()), default=0) > TABLE else "text"
    return f"```{kind}\n{text}\n```"

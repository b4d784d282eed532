"""What documents contain: their commands, in order, and their words."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md")))
BLOCK = re.compile(r"^```sh\n(.*?)^```", re.S | re.M)


@dataclass(frozen=True)
class Step:
    """What a reader types: a command, with the lines of a here-document where it has one.

    Attributes:
        text: as it is typed, without a comment.
        words: of `tepm …`, else empty.
    """

    text: str

    @property
    def words(self) -> list[str]:
        """Its words where it is `tepm …`, else none."""
        first = shlex.split(self.text.partition("\n")[0])
        return first if first[:1] == ["tepm"] else []


def steps(document: Path) -> list[Step]:
    """All commands of the blocks `sh` of a document, in order; lines that end with a backslash and here-documents belong together."""
    return [step for block in BLOCK.findall(document.read_text(encoding="utf-8")) for step in _of_block(block)]


def answers(page: Path) -> list[Step]:
    """Commands that answer the questions in bold of a page, in order."""
    text = " ".join(page.read_text(encoding="utf-8").split())
    return [Step(command) for command in re.findall(r"\?\*\* `(tepm [^`]+)`", text)]


def _of_block(block: str) -> Iterator[Step]:
    lines = iter(block.splitlines())
    for line in lines:
        text = re.sub(r"\s+#\s.*$", "", line).strip()
        if not text or text.startswith("#"):
            continue
        while text.endswith("\\"):
            text = text[:-1] + next(lines).strip()
        if ending := re.search(r"<<\s*'?(\w+)'?", text):
            text = "\n".join([text, *iter(lambda: next(lines), ending[1]), ending[1]])
        yield Step(text)

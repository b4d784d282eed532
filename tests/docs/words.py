"""How plainly documents, names and docstrings are written: words a sentence, bare participles as names, docstrings that are riddles."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

LONG = 25
"""Words above which a sentence is long."""
PREPOSITIONS = re.compile(
    r"about|above|across|after|against|ahead|along|among|apart|around|aside|at|before|behind|below|beneath|beside|besides|"
    r"between|beyond|by|during|except|for|from|in|inside|into|near|of|off|on|onto|out|outside|over|past|since|through|"
    r"throughout|till|to|together|toward|towards|under|until|up|upon|with|within|without"
)
NO_PARTICIPLES = re.compile(r"bring|embed|feed|need|reseed|seed|speed|spring|string")
IRREGULAR = re.compile(
    r"begun|beaten|borne|bound|broken|brought|built|caught|chosen|come|drawn|driven|eaten|fallen|felt|forgotten|found|given|"
    r"gone|grown|heard|held|kept|known|laid|lain|led|left|lent|lost|made|meant|met|sent|shown|sought|spoken|sprung|stood|taken|"
    r"thought|told|took|turned|woken|worn|written"
)
FUNCTION = re.compile(r"(@[\w.]*property[^\n]*\n\s*)?def (\w+)\(")
RIDDLE = re.compile(r'^\s*(?:def [^\n]*)?"{1,3}((?:What|Which|How|Where|Why|That|Of|Whose)\b[^\n"]*)', re.M)


@dataclass(frozen=True)
class Sentences:
    """Lengths of a document's sentences, in words; tables, headings and code do not count."""

    lengths: tuple[int, ...]

    @property
    def mean(self) -> float:
        """Words a sentence."""
        return sum(self.lengths) / max(len(self.lengths), 1)

    @property
    def long_share(self) -> float:
        """Share of long sentences, 0 to 1."""
        return sum(length > LONG for length in self.lengths) / max(len(self.lengths), 1)


def measure_sentences(markdown: str) -> Sentences:
    """Lengths of the sentences of a Markdown text."""
    text = re.sub(r"```.*?```|<[^>]+>", " ", markdown, flags=re.DOTALL)
    lines = [line for line in text.split("\n") if not re.match(r"\s*(\||#|!\[|\[.*\]:|[-=]{3,})", line)]
    text = re.sub(r"`[^`]*`", "code", re.sub(r"\]\([^)]*\)", "]", "\n".join(lines)))
    parts = re.split(r"(?<=[.!?:;])\s+|\n\s*\n|\n\s*(?:[-*]|\d+[.)])\s+", text)
    counts = (len(re.findall(r"[\w'’%°²³]+", part)) for part in parts)
    return Sentences(tuple(count for count in counts if count > 2))


def bare_names(code: str) -> Iterator[str]:
    """Functions of a module that are named by a participle or a preposition alone; properties may be."""
    for is_property, name in FUNCTION.findall(code):
        bare = name.strip("_")
        participle = IRREGULAR.fullmatch(bare) or re.fullmatch(r"[a-z]+(ed|ing)", bare)
        if not is_property and (PREPOSITIONS.fullmatch(bare) or (participle and not NO_PARTICIPLES.fullmatch(bare))):
            yield name


def riddles(code: str) -> list[str]:
    """First lines of a module's docstrings that begin with a question word, `That` or `Of`."""
    return RIDDLE.findall(code)

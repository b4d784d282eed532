"""Equations as MathML, which browsers draw by themselves: no script, no fonts, nothing to fetch."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert

TAG = re.compile(r"\\tag\{(.*?)\}")


def inline(writer: Any, node: nodes.math) -> None:
    """Write an equation in a line.

    Raises:
        SkipNode: always: its children are done.
    """
    writer.body.append(convert(node.astext()))
    raise nodes.SkipNode


def block(writer: Any, node: nodes.math_block) -> None:
    """Write a displayed equation; its `\\tag`, which plain git hosts show as well, is the number at the margin.

    Raises:
        SkipNode: always: its children are done.
    """
    text = node.astext()
    number = TAG.search(text)
    shown = f'<span class="number" id="eq-{number[1]}">({number[1]})</span>' if number else ""
    writer.body.append(f'<div class="equation">{convert(TAG.sub("", text).strip(), display="block")}{shown}</div>\n')
    raise nodes.SkipNode

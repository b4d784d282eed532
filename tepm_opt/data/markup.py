"""Tables in HTML for notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def html_table(head: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "") -> str:
    """A small HTML table; all text is escaped."""
    lines = ["<table>", f"<caption>{escape(caption)}</caption>"] if caption else ["<table>"]
    lines.append(_row("th", head))
    lines += [_row("td", row) for row in rows]
    return "".join((*lines, "</table>"))


def _row(tag: str, fields: Sequence[str]) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(field)}</{tag}>' for field in fields)}</tr>"

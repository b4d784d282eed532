"""Short texts of results: what their `repr` and their tables in notebooks are made of."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np


def millimetres(position: Sequence[float] | np.ndarray) -> str:
    """A position (3,) in m as "(1.00, 2.00, 3.00) mm"."""
    return f"({', '.join(f'{round(1e3 * value, 2) + 0.0:.2f}' for value in position)}) mm"


def quantity(value: float, unit: str) -> str:
    """A value in its unit, lengths in m as "1.2 mm", with two digits below 1 mm."""
    if unit != "m":
        return f"{value:.3g} {unit}".strip()
    return f"{1e3 * value:.1f} mm" if value >= 1e-3 else f"{1e3 * value:.2g} mm"


def digits(value: float | None, factor: float = 1.0, form: str = "#.3g") -> str:
    """A value with three digits and more where it is 1000 and larger, times a factor; a dash where there is none."""
    if value is None or not np.isfinite(value):
        return "–"
    whole = abs(factor * value) >= 999.5 and form == "#.3g"
    return format(factor * value, ".0f" if whole else form).rstrip(".")


def format_quantity(value: float, unit: str) -> str:
    """A value with three digits and its unit, lengths in mm; a dash where there is none."""
    text, shown = (digits(value, 1e3), "mm") if unit == "m" else (digits(value), unit)
    return text if text == "–" else f"{text} {shown}"


def with_deviation(value: float, std: float) -> str:
    """A value and its standard deviation, as many digits of the one as the other knows: "9.9974 ± 0.0037"; alone where that is none."""
    if not (np.isfinite(std) and std > 0):
        return f"{value:.6g}"
    known = max(2, min(9, 2 + int(np.floor(np.log10(max(abs(value) / std, 1.0))))))
    return f"{_plain(value, known)} ± {_plain(std, 2)}"


def _plain(value: float, digits: int) -> str:
    """A number of so many digits, without an exponent where five digits do."""
    text = f"{value:.{digits}g}"
    return f"{float(text):g}" if "e+" in text and abs(value) < 1e5 else text


def percent(part: float | None) -> str:
    """A part of one in percent; what is nearly all or nothing is not rounded to it."""
    if part is None or not np.isfinite(part):
        return "–"
    if 0 < part < 0.01 or 0.99 < part < 1:
        return "< 1 %" if part < 0.5 else "> 99 %"
    return f"{100 * part:.0f} %"


def format_names(names: Sequence[str], most: int = 4) -> str:
    """Join names by commas, the first ones only where there are more: "K_a, c_a, r and 3 more"."""
    return ", ".join(names) if len(names) <= most else f"{', '.join(names[: most - 1])} and {len(names) - most + 1} more"


def shorten(text: str, length: int) -> str:
    """Shorten a text to at most so many characters, with an ellipsis where something is missing."""
    return text if len(text) <= length else f"{text[: length - 1]}…"


def align_columns(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table for a terminal, columns two spaces apart."""
    table = [head, *rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in table]


def html_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table for notebooks; texts are escaped."""
    titles = "".join(f"<th>{escape(title)}</th>" for title in head)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table><thead><tr>{titles}</tr></thead><tbody>{body}</tbody></table>"

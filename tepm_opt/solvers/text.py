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


def with_deviation(value: float, std: float) -> str:
    """A value and its standard deviation, as many digits of the one as the other knows: "9.9974 ± 0.0037"; alone where that is none."""
    if not (np.isfinite(std) and std > 0):
        return f"{value:.6g}"
    known = max(2, min(9, 2 + int(np.floor(np.log10(max(abs(value) / std, 1.0))))))
    return f"{value:.{known}g} ± {std:.2g}"


def listed(names: Sequence[str], most: int = 4) -> str:
    """Names by commas, the first ones only where there are more: "K_a, c_a, r and 3 more"."""
    return ", ".join(names) if len(names) <= most else f"{', '.join(names[: most - 1])} and {len(names) - most + 1} more"


def shortened(text: str, length: int) -> str:
    """A text of at most so many characters, with an ellipsis where something is missing."""
    return text if len(text) <= length else f"{text[: length - 1]}…"


def html_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table for notebooks; texts are escaped."""
    titles = "".join(f"<th>{escape(title)}</th>" for title in head)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table><thead><tr>{titles}</tr></thead><tbody>{body}</tbody></table>"

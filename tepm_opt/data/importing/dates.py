"""Dates and times of day as people write them: `02.03.2026 11:05:12.345`, `11:05:12 PM`. Which is the day is asked, not guessed."""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import date

import numpy as np

from tepm_opt.data.importing.refusals import lines_of, question, refusal
from tepm_opt.data.importing.sources import Sheet

DAY_FIRST, MONTH_FIRST = "day first", "month first"
DAY = 86400.0  # s
_LOCAL = re.compile(
    r"(?:(?P<a>\d{1,4})[./-](?P<b>\d{1,2})[./-](?P<c>\d{2,4})[ T,]+)?"
    r"(?P<h>\d{1,2}):(?P<m>\d{2})(?::(?P<s>\d{2})(?:[.,:](?P<f>\d+))?)? ?(?P<half>[ap]\.?m\.?)?",
    re.I,
)
_ISO = re.compile(r"\d{4}-\d\d-\d\d[T ]")


def are_local_times(values: np.ndarray) -> bool:
    """Whether texts are times of day or dates that no standard orders."""
    texts = [str(value).strip() for value in values[:50] if str(value).strip()]
    return bool(texts) and all(_LOCAL.fullmatch(text) and not _ISO.match(text) for text in texts)


def local_seconds(
    sheet: Sheet, name: str, values: np.ndarray, order: str | None, entry: Callable[[str], str]
) -> tuple[np.ndarray, float | None]:
    """Texts in s, (rows,), NaN where they are empty; and a day, at which times without a date begin again.

    Args:
        sheet: the file.
        name: of the column.
        values: texts.
        order: "day first" or "month first"; None where the map does not say.
        entry: of the map for an order.

    Raises:
        InputError: a day and a month that might be either; text that is no time; names the entry or the question.
    """
    found = [_LOCAL.fullmatch(str(value).strip()) for value in values]
    if wrong := [row for row, each in enumerate(found) if each is None and str(values[row]).strip()]:
        where = lines_of([sheet.line(row) for row in wrong])
        raise refusal(f"{sheet.path}: {where}", f"column {name!r} (time): {values[wrong[0]]!r} is no time such as {values[0]!r}")
    dated = {row: each for row, each in enumerate(found) if each is not None and each["a"] and len(each["a"]) < 3}
    certain = _order_of([(int(each["a"]), int(each["b"])) for each in dated.values()])
    if dated and certain is None and order is None:
        text = str(values[next(iter(dated))])
        answers = (entry(DAY_FIRST), entry(MONTH_FIRST))
        raise question(sheet.path, f"column {name!r} (time): {text!r}: is the day or the month first?", *answers)
    if certain and order and certain not in (order, "either"):
        text = next(str(values[row]) for row, each in dated.items() if max(int(each["a"]), int(each["b"])) > 12)
        raise refusal(sheet.path, f"column {name!r} (time): {text!r} has no {order.split()[0]} first", entry(certain))
    chosen = order or certain or DAY_FIRST
    times = np.array([np.nan if each is None else _seconds(each, chosen) for each in found])
    return times, None if any(each is not None and each["a"] for each in found) else DAY


def _order_of(pairs: list[tuple[int, int]]) -> str | None:
    """Order that the numbers of dates allow, "either" where both mean the same, None where they differ."""
    if any(first > 12 for first, _ in pairs):
        return DAY_FIRST
    if any(second > 12 for _, second in pairs):
        return MONTH_FIRST
    return "either" if pairs and all(first == second for first, second in pairs) else None


def _seconds(found: re.Match[str], order: str) -> float:
    """A time of day or a date in s."""
    hour = int(found["h"])
    if found["half"]:
        hour = hour % 12 + (12 if found["half"][0] in "pP" else 0)
    time = 3600.0 * hour + 60.0 * int(found["m"]) + int(found["s"] or 0) + float(f"0.{found['f'] or 0}")
    if not found["a"]:
        return time
    a, b, c = int(found["a"]), int(found["b"]), int(found["c"])
    year, month, day = (a, b, c) if len(found["a"]) > 2 else (c, b, a) if order == DAY_FIRST else (c, a, b)
    try:
        days = date(year + (2000 if year < 100 else 0), month, day).toordinal() - date(1970, 1, 1).toordinal()
    except ValueError:
        return np.nan
    return DAY * days + time

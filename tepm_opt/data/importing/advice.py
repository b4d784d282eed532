"""Advice that was tried: entries of a map are proposed only where reading the files with them leads to a data set."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from typing import Any

from tepm_opt.data.importing.refusals import BETWEEN, PUT, TableError
from tepm_opt.errors import InputError

MOST = 8  # refusals one after another
Content = Mapping[str, Any]


def merge_maps(one: Content, other: Content) -> dict[str, Any]:
    """The content of a map with other entries; tables key by key."""
    found = dict(one)
    for name, value in other.items():
        old = found.get(name)
        found[name] = merge_maps(old, value) if isinstance(value, dict) and isinstance(old, dict) else value
    return found


def entries_of(error: InputError) -> tuple[str, ...]:
    """Entries that a refusal proposes."""
    if isinstance(error, TableError):
        return error.entries
    _, put, proposed = str(error).partition(PUT)
    return tuple(proposed.split(BETWEEN)) if put else ()


def try_entries(content: Content, error: InputError, attempt: Callable[[Content], Any]) -> tuple[dict[str, Any], InputError | None]:
    """The map after all entries that refusals propose, and the refusal at which they end.

    Args:
        content: of the map.
        error: the first refusal.
        attempt: reads the files with a map.

    Returns:
        The content; None where it leads to a data set, else the refusal that no entry mends.
    """
    found, seen = dict(content), {str(error)}
    for _ in range(MOST):
        if not (entries := entries_of(error)):
            return found, error
        try:
            for entry in entries:
                found = merge_maps(found, tomllib.loads(entry))
            attempt(found)
        except tomllib.TOMLDecodeError:
            return found, error
        except InputError as following:
            error = following
            if str(error) in seen:
                return found, error
            seen.add(str(error))
        else:
            return found, None
    return found, error


def with_tried_entries(content: Content, error: InputError, attempt: Callable[[Content], Any]) -> InputError:
    """A refusal without the entries that lead to no data set; with the reason why they do not.

    Entries also stay where they lead to a question that only a person can answer.

    Args:
        content: of the map.
        error: the refusal.
        attempt: reads the files with a map.
    """
    if not entries_of(error):
        return error
    _, end = try_entries(content, error, attempt)
    if end is None or (isinstance(end, TableError) and end.asks):
        return error
    found = str(error).partition(PUT)[0]
    reason = str(end).partition(PUT)[0]
    return InputError(found if reason == found else f"{found}; no entry of the map mends it: {reason}")

"""The one exception a person can cause, and how it names what would have worked."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """Wrong input by a person, told in one line with what would be valid.

    The message is one line: where it is (file, line, key), what was found and what is valid. Command lines print it without a traceback.
    """


def unknown_name(kind: str, name: str, valid: Iterable[str], where: str = "") -> InputError:
    """An `InputError` for a name that is not in `valid`: lists the valid ones and suggests the most similar.

    Args:
        kind: what the name stands for, such as "effect".
        name: the unknown name.
        valid: all names that would have worked.
        where: file or option that it stands in; empty for none.
    """
    names = sorted(valid)
    near = difflib.get_close_matches(name, names, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    prefix = f"{where}: " if where else ""
    return InputError(f"{prefix}unknown {kind} {name!r}: {hint}valid: {', '.join(names) or 'none'}")

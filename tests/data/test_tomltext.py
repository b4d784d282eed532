"""Numbers of TOML files are changed in place."""

from __future__ import annotations

import pytest

from tepm_opt.data.tomltext import with_numbers
from tepm_opt.errors import InputError

TEXT = "# head\n[a]\nx = 1.0   # an x\n\n[a.b]   # inner\ny = [1, 2]\n[c]\nx = 3\n"


def test_a_number_is_replaced_or_added_and_comments_stay() -> None:
    assert with_numbers(TEXT, "a", {"x": 2.5}, "f") == TEXT.replace("1.0", "2.5")
    assert with_numbers(TEXT, "a.b", {"z": 7.0}, "f") == TEXT.replace("# inner\n", "# inner\nz = 7.0\n")
    assert with_numbers(TEXT, "c", {"x": 4}, "f") == TEXT.replace("x = 3", "x = 4")
    assert with_numbers(TEXT, "a.b", {"y": [3.0, -1.0]}, "f") == TEXT.replace("[1, 2]", "[3.0, -1.0]")


def test_what_cannot_be_changed_is_refused() -> None:
    with pytest.raises(InputError, match=r"no table \[d\]"):
        with_numbers(TEXT, "d", {"x": 1.0}, "f")
    with pytest.raises(InputError, match="could not be replaced"):
        with_numbers("[a]\n'x' = 1\n", "a", {"x": 2.0}, "f")

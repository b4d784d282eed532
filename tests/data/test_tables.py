"""CSV tables: exact round trips, and one clear line for everything that can be wrong."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tepm_opt.data.tables import read_table, write_table
from tepm_opt.errors import InputError

NAMES = st.lists(st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True), min_size=1, max_size=5, unique=True)


@given(st.data(), NAMES)
def test_round_trip_is_exact(tmp_path_factory, data, names):
    rows = data.draw(arrays(float, st.tuples(st.integers(1, 6), st.just(len(names))), elements=st.floats(width=64)))
    path = tmp_path_factory.getbasetemp() / "round_trip.csv"
    write_table(path, names, rows)
    table = read_table(path)
    assert list(table.columns) == names
    np.testing.assert_array_equal(np.stack(list(table.columns.values()), axis=1), rows)
    assert table.lines == tuple(range(2, len(rows) + 2))


def test_what_spreadsheets_write_is_read(tmp_path):
    path = tmp_path / "table.csv"
    path.write_bytes('\ufeff"time_s", x_m\r\n0, 1e-3\r\n\r\n1,\r\n'.encode())
    table = read_table(path)
    assert list(table.columns) == ["time_s", "x_m"]
    np.testing.assert_array_equal(table.columns["time_s"], [0, 1])
    np.testing.assert_array_equal(table.columns["x_m"], [1e-3, np.nan])
    assert table.lines == (2, 4)
    assert "time_s" in table
    assert "x" not in table


MALFORMED = {
    "empty": ("", "is empty; valid: a header line and at least one row"),
    "blank lines only": ("\n\n", "is empty"),
    "header only": ("a,b\n", "has no rows"),
    "column twice": ("a,b, a\n1,2,3\n", "line 1: column 'a' stands twice"),
    "too few fields": ("a,b\n1,2\n3\n", "line 3: 1 fields, the header has 2"),
    "too many fields": ("a,b\n\n1,2,3\n", "line 3: 3 fields, the header has 2"),
    "text": ("a,b\n1,2\n1,two\n", "line 3: b = 'two' is not a number"),
    "decimal comma": ('a,b\n1,"2,5"\n', "line 2: b = '2,5' is not a number"),
    "semicolons": ("a;b\n1;2\n", "line 1: columns are separated by ';'; valid: ','"),
    "text of two lines": ('a,b\n1,2\n1,"x\ny"\n', "line 4: b = 'x\\ny' is not a number"),
}


@pytest.mark.parametrize(("text", "message"), MALFORMED.values(), ids=MALFORMED)
def test_malformed_tables(tmp_path, text, message):
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_table(path)
    assert str(error.value).startswith(f"{path}: {message}")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "message"),
    [("binary.csv", "is not a CSV text file"), ("missing.csv", "cannot be read: No such file"), (".", "cannot be read")],
)
def test_files_that_are_no_tables(tmp_path, name, message):
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InputError) as error:
        read_table(tmp_path / name)
    assert str(error.value).startswith(f"{tmp_path / name}: {message}")


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("0,1\n1,\n", "line 3: x is empty; valid: a finite number"),
        ("0,1\n1,inf\n", "line 3: x = inf; valid: a finite number"),
        ("0,1\n0,1\n", "line 3: t = 0; valid: larger than in the row before"),
        ("0,1\n2,1\n1,1\n", "line 4: t = 1; valid: larger than in the row before"),
        (",1\n", "line 2: t is empty; valid: a finite number"),
    ],
)
def test_wrong_values(tmp_path, rows, message):
    path = tmp_path / "table.csv"
    path.write_text(f"t,x\n{rows}")
    table = read_table(path)
    with pytest.raises(InputError) as error:
        _ = table.read_increasing("t"), table.column("x")
    assert str(error.value) == f"{path}: {message}"


def test_a_missing_column_lists_those_found(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("t,x\n0,1\n")
    with pytest.raises(InputError) as error:
        read_table(path).column("y")
    assert str(error.value) == f"{path}: column 'y' is missing; found: t, x"

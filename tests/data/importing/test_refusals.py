"""Tables and maps that are wrong: one line names all columns concerned and the entry of the map that mends it; put there, it does."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tepm_opt.data.importing.refusals import BETWEEN, PUT, key, toml
from tepm_opt.data.importing.sources import SUFFIXES
from tepm_opt.errors import InputError
from tepm_opt.jobs.import_data import run_import
from tests.data.importing.layouts import even, text
from tests.data.importing.truth import COMMANDS, PLACES, signals
from tests.data.made import ACTUATORS, POINTS

PRESSURES, TENSIONS = COMMANDS[:6], COMMANDS[6:]
GOOD: dict[str, Any] = {
    "robot": "kang2017",
    "time": {"column": "t"},
    "pressure": {"columns": "pressure_{name}_Pa"},
    "tension": {"columns": "tension_{name}_N"},
    "position": {"columns": "{name}_{axis}_m"},
}


@dataclass(frozen=True)
class Malformed:
    """Files and a map that do not go together.

    Attributes:
        files: that were written.
        map: content of the map.
        concerned: all columns that the refusal has to name.
        says: what else it has to say: a line, a reason.
    """

    files: Sequence[Path]
    map: Mapping[str, Any]
    concerned: Sequence[str]
    says: Sequence[str] = ()


CASES: dict[str, Callable[[Path], Malformed]] = {}


def case(write: Callable[[Path], Malformed]) -> Callable[[Path], Malformed]:
    CASES[write.__name__] = write
    return write


def table(rate: float = 50) -> dict[str, Any]:
    time = even(rate)
    found = signals(time)
    return {"t": time} | {n: found[n] for n in (*COMMANDS, *PLACES)}


def given(**changed: Any) -> dict[str, Any]:
    """The good map with other entries; None leaves one out, tables are merged."""
    return {name: value for name, value in merged(GOOD, changed).items() if value is not None}


def merged(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    found = dict(one)
    for name, value in other.items():
        found[name] = merged(found[name], value) if isinstance(value, dict) and isinstance(found.get(name), dict) else value
    return found


@case
def another_separator(folder: Path) -> Malformed:
    return Malformed([text(folder / "a.csv", table(), ";")], given(), ["t", *COMMANDS, *PLACES], ["line 1"])


@case
def tabs(folder: Path) -> Malformed:
    return Malformed([text(folder / "a.txt", table(), "\t")], given(), ["t", *COMMANDS, *PLACES])


@case
def decimal_commas(folder: Path) -> Malformed:
    path = text(folder / "a.csv", table(), ";", ",")
    return Malformed([path], given(csv={"separator": ";"}), PRESSURES, ["decimal commas", "line"])


@case
def no_header(folder: Path) -> Malformed:
    numbers = {"pressure": (2, 8), "tension": (8, 14), "position": (14, 26)}
    columns: dict[str, Any] = {place: {"columns": list(range(*ends))} for place, ends in numbers.items()}
    return Malformed([text(folder / "a.csv", table(), header=False)], given(time={"column": 1}, **columns), ["0"], ["line 1", "numbers"])


@case
def lines_before_the_header(folder: Path) -> Malformed:
    path = text(folder / "a.csv", table(), before=["recorded by nobody", "2026-11-20"])
    return Malformed([path], given(), ["t", *COMMANDS, *PLACES], ["line 3"])


@case
def units_under_the_header(folder: Path) -> Malformed:
    path = text(folder / "a.csv", table(), behind=[",".join(["s"] + ["Pa"] * 6 + ["N"] * 6 + ["m"] * 12)])
    return Malformed([path], given(), ["t 's'", "pressure_11_Pa 'Pa'", *TENSIONS, *PLACES], ["line 2"])


@case
def other_encoding(folder: Path) -> Malformed:
    path = text(folder / "a.csv", table() | {"T in °C": even(50)}, encoding="latin-1")
    return Malformed([path], given(), ["T in °C"], ["line 1", "is not utf-8"])


@case
def misspelt_columns(folder: Path) -> Malformed:
    columns = {name.replace("_Pa", "_pa").replace("s3", "S3"): values for name, values in table().items()}
    return Malformed([text(folder / "a.csv", columns)], given(), [*PRESSURES, *PLACES[6:9]], ["pressure_11_pa"])


@case
def time_of_another_name(folder: Path) -> Malformed:
    columns = {name.replace("t", "Time [s]") if name == "t" else name: values for name, values in table().items()}
    return Malformed([text(folder / "a.csv", columns)], given(), ["t"], ["Time [s]"])


@case
def names_that_stand_twice(folder: Path) -> Malformed:
    names = ["t", *COMMANDS, *["X", "Y", "Z"] * 4]
    rows = "\n".join(",".join(f"{value:.9g}" for value in row) for row in zip(*table().values(), strict=True))
    (folder / "a.csv").write_text(",".join(names) + "\n" + rows + "\n")
    return Malformed([folder / "a.csv"], given(position={"columns": ["X", "Y", "Z"] * 4}), ["X", "Y", "Z"], ["14 and 17 and 20 and 23"])


@case
def words_for_lost_samples(folder: Path) -> Malformed:
    columns = table()
    for name in PLACES[3:6]:
        columns[name] = ["-" if 20 <= k < 23 else f"{value:.9g}" for k, value in enumerate(columns[name])]
    return Malformed([text(folder / "a.csv", columns)], given(), PLACES[3:6], ["lines 22, 23, 24", "'-'"])


@case
def zeros_for_lost_samples(folder: Path) -> Malformed:
    columns = table()
    for name in PLACES[3:9]:
        columns[name] = np.where(np.isin(np.arange(301), [40, 41]), 0.0, columns[name])
    return Malformed([text(folder / "a.csv", columns)], given(), PLACES[3:9], ["lines 42, 43"])


@case
def positions_in_mm(folder: Path) -> Malformed:
    columns = {name: 1e3 * values if name in PLACES else values for name, values in table().items()}
    return Malformed([text(folder / "a.csv", columns)], given(), PLACES, ["if in m", 'position.unit = "mm"'])


@case
def pressures_in_bar(folder: Path) -> Malformed:
    columns = {name: values / 1e5 if name in PRESSURES else values for name, values in table().items()}
    return Malformed(
        [text(folder / "a.csv", columns)], given(), PRESSURES, ["if it is in Pa", "limit is 500000 Pa", 'pressure.unit = "bar"']
    )


@case
def tensions_in_mn(folder: Path) -> Malformed:
    columns = {name: values * 1e3 if name in TENSIONS else values for name, values in table().items()}
    return Malformed([text(folder / "a.csv", columns)], given(), TENSIONS, ["limit is 7 N", 'tension.unit = "mN"'])


@case
def time_in_ms(folder: Path) -> Malformed:
    columns = table()
    return Malformed([text(folder / "a.csv", columns | {"t": 1e3 * columns["t"]})], given(), PLACES, ["20 s apart", 'time.unit = "ms"'])


@case
def time_goes_back(folder: Path) -> Malformed:
    one, two = signals(even(50)), signals(even(50), 1)
    columns = {"t": np.tile(even(50), 2)} | {n: np.concatenate([one[n], two[n]]) for n in (*COMMANDS, *PLACES)}
    return Malformed([text(folder / "a.csv", columns)], given(), ["t"], ["line 303", "from 6 to 0 s"])


@case
def time_stands(folder: Path) -> Malformed:
    columns = table()
    columns["t"][100] = columns["t"][99]
    return Malformed([text(folder / "a.csv", columns)], given(), ["t"], ["line 102"])


@case
def dates(folder: Path) -> Malformed:
    columns = table()
    columns["t"] = np.datetime_as_string(np.datetime64("2026-11-20") + (1e3 * columns["t"]).astype("timedelta64[ms]"), unit="ms")
    return Malformed([text(folder / "a.csv", columns)], given(), ["t"], ["2026-11-20T00:00:00.000"])


@case
def commands_only_where_they_change(folder: Path) -> Malformed:
    columns = table()
    for name in COMMANDS[:7]:
        columns[name] = ["" if k % 2 else f"{value:.9g}" for k, value in enumerate(columns[name])]
    return Malformed([text(folder / "a.csv", columns)], given(), COMMANDS[:7], ["lines 3, 5, 7 and 147 more"])


@case
def more_rows_than_samples(folder: Path) -> Malformed:
    return Malformed([text(folder / "a.csv", table())], given(rate_hz=500), PLACES, ["50 samples a second", "rate_hz = 500"])


@case
def two_clocks_in_one_file(folder: Path) -> Malformed:
    from scipy.io import savemat

    slow, fast = even(50), even(100)
    found = {n: signals(slow)[n] for n in COMMANDS} | {n: signals(fast)[n] for n in PLACES}
    savemat(folder / "a.mat", {"t": slow, "t_camera": fast, **found})
    return Malformed([folder / "a.mat"], given(), PLACES, ["601 rows", "'t' (time) has 301"])


@case
def clocks_that_never_meet(folder: Path) -> Malformed:
    columns = table()
    first = text(folder / "a_valves.csv", {n: columns[n] for n in ("t", *COMMANDS)})
    second = text(folder / "a_camera.csv", {"t": columns["t"] + 1.7e9} | {n: columns[n] for n in PLACES}, digits=16)
    files = {"pressure": "*_valves.csv", "tension": "*_valves.csv", "position": "*_camera.csv"}
    return Malformed(
        [first, second], given(**{name: {"file": file} for name, file in files.items()}), [*COMMANDS, *PLACES], ["from 0 to 6 s"]
    )


@case
def a_file_that_fits_nothing(folder: Path) -> Malformed:
    columns = table()
    first = text(folder / "a_valves.csv", {n: columns[n] for n in ("t", *COMMANDS)})
    second = text(folder / "a_camera.csv", {n: columns[n] for n in ("t", *PLACES)})
    changed = given(pressure={"file": "*_valves.csv"}, tension={"file": "*_valves.csv"}, position={"file": "*_tracker.csv"})
    return Malformed([first, second], changed, ["a_camera.csv"], ["*_valves.csv, *_tracker.csv"])


@case
def axes_of_another_frame(folder: Path) -> Malformed:
    columns = table()
    for name in POINTS:
        x, y, z = (columns[f"{name}_{axis}_m"] for axis in "xyz")
        columns |= {f"{name}_x_m": x, f"{name}_y_m": z, f"{name}_z_m": -y}
    return Malformed([text(folder / "a.csv", columns)], given(), PLACES[9:], ["not above the base", 'frame.axes = ["x", "-z", "y"]'])


@case
def fewer_columns_than_actuators(folder: Path) -> Malformed:
    return Malformed(
        [text(folder / "a.csv", table())],
        given(pressure={"columns": list(PRESSURES[3:])}),
        PRESSURES[3:],
        ["for 6 (11, 12, 13, 21, 22, 23)"],
    )


@case
def a_point_that_the_robot_has_not(folder: Path) -> Malformed:
    return Malformed([text(folder / "a.csv", table())], given(position={"of": ["s3", "s4", "s5"]}), ["s5"], ["s1, s2, s3, s4"])


@case
def a_placeholder_that_is_none(folder: Path) -> Malformed:
    columns = {f"p_{k + 1}" if n in PRESSURES else n: v for n, v, k in zip(table(), table().values(), range(-1, 99), strict=False)}
    return Malformed([text(folder / "a.csv", columns)], given(pressure={"columns": "p_{valve}"}), ["p_{valve}"], ["{n}, {n0}, {name}"])


@case
def a_unit_that_is_none(folder: Path) -> Malformed:
    columns = {name: values / 1e3 if name in PRESSURES else values for name, values in table().items()}
    return Malformed([text(folder / "a.csv", columns)], given(pressure={"unit": "KPA"}), ["pressure"], ["'KPA'", "bar, psi"])


@case
def a_length_in_psi(folder: Path) -> Malformed:
    return Malformed([text(folder / "a.csv", table())], given(position={"unit": "psi"}), ["position"], ["m, cm, mm"])


@case
def no_position(folder: Path) -> Malformed:
    return Malformed([text(folder / "a.csv", table())], given(position=None), ["t", *COMMANDS, *PLACES])


@case
def no_robot(folder: Path) -> Malformed:
    return Malformed([text(folder / "a.csv", table())], given(robot=None), ["pressure"])


@case
def a_run_that_is_none(folder: Path) -> Malformed:
    return Malformed([text(folder / "a.csv", table())], given(validation=["b"]), ["'b'"], ["runs: a"])


@case
def outputs_without_noise(folder: Path) -> Malformed:
    random = np.random.default_rng(0)
    columns = {"t": even(50), "u": even(50), "x": random.normal(0, 2e-3, 301)}
    changed = {"time": {"column": "t"}, "inputs": {"force": {"column": "u"}}, "outputs": {"place": {"column": "x"}}}
    return Malformed([text(folder / "a.csv", columns)], changed, ["place"], ["noise.place = 2"])


def entries(message: str) -> list[str]:
    """The entries that a refusal proposes."""
    _, found, proposed = message.partition(PUT)
    return proposed.split(BETWEEN) if found else []


def write_map(path: Path, content: Mapping[str, Any]) -> Path:
    path.write_text("\n".join(f"{key(name)} = {toml(value)}" for name, value in content.items()) + "\n", encoding="utf-8")
    return path


def refused(files: Sequence[Path], map_file: Path) -> str:
    with pytest.raises(InputError) as caught:
        run_import(files, map_file)
    message = str(caught.value)
    assert "\n" not in message
    return message


@pytest.mark.sample(3)
@pytest.mark.parametrize("name", CASES)
def test_one_line_names_all_columns_and_mends_it(name: str, tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    wrong = CASES[name](tmp_path)
    message = refused(wrong.files, write_map(tmp_path / "map.toml", wrong.map))
    before, _, _ = message.partition(PUT)
    assert str(wrong.files[0].parent) in message
    assert not [column for column in wrong.concerned if column not in before], message
    assert not [each for each in wrong.says if each not in message], message
    assert entries(message), message
    content = dict(wrong.map)
    for entry in entries(message):
        content = merged(content, tomllib.loads(entry))
    write_map(tmp_path / "map.toml", content)
    assert run_import(wrong.files, tmp_path / "map.toml").runs


def test_there_are_many() -> None:
    assert len(CASES) >= 30


def test_unknown_keys_list_the_valid_ones(tmp_path: Path) -> None:
    path = text(tmp_path / "a.csv", table())
    message = refused([path], write_map(tmp_path / "map.toml", given(presure={"columns": "p{n}"})))
    assert "did you mean 'pressure'?" in message
    assert "csv, extra, frame, inputs" in message
    message = refused([path], write_map(tmp_path / "map.toml", given(position={"units": "mm"})))
    assert "position: unknown key 'units': did you mean 'unit'? valid: between, columns, file" in message


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.csv", b"", "is empty"),
        ("a.csv", b"t,x\n", "has no rows"),
        ("a.csv", b"t,x\n0,1\n1,2,3\n2,3\n3,4\n", "line 3: 3 fields for 2 columns (t, x)"),
        ("a.parquet", b"no parquet", "is not a Parquet file"),
        ("a.mat", b"no mat", "is not a MAT file"),
        ("a.h5", b"no hdf", "is not an HDF5 file"),
        ("a.bag", b"no bag", "is not a ROS bag that can be read"),
        ("a.mcap", b"no bag", "is not a ROS bag that can be read"),
        ("a.xlsx", b"PK", f"unknown kind of file '.xlsx'; valid: {', '.join(SUFFIXES)}"),
    ],
)
def test_files_that_no_map_can_mend(name: str, content: bytes, says: str, tmp_path: Path) -> None:
    for module in ("pandas", "pyarrow", "h5py", "rosbags"):
        pytest.importorskip(module)
    (tmp_path / name).write_bytes(content)
    message = refused([tmp_path / name], write_map(tmp_path / "map.toml", GOOD))
    assert message.startswith(f"{tmp_path / name}: ")
    assert says in message


@pytest.mark.parametrize(("suffix", "module"), [("csv", "pandas"), ("parquet", "pyarrow"), ("h5", "h5py"), ("mcap", "rosbags.highlevel")])
def test_what_is_not_installed_is_told(suffix: str, module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / f"a.{suffix}").write_text("t\n0\n")
    message = refused([tmp_path / f"a.{suffix}"], write_map(tmp_path / "map.toml", GOOD))
    assert message.endswith(f'needs {module.partition(".")[0]}, which is not installed: pip install "tepm-opt[data]"')


def test_one_wrong_time_makes_no_endless_grid(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    columns = table()
    columns["t"][-1] = 1.7e9
    message = refused([text(tmp_path / "a.csv", columns)], write_map(tmp_path / "map.toml", GOOD))
    assert "8.5e+10 rows of 301 samples: a wrong time among them" in message


def test_no_actuator_is_left_out_silently(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    path = text(tmp_path / "a.csv", table())
    some = given(pressure={"of": list(ACTUATORS[:3])})
    notes = run_import([path], write_map(tmp_path / "map.toml", some)).notes
    assert "no pressure of 21, 22, 23 in the map: 0 throughout" in notes

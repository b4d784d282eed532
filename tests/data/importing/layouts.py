"""Tables as laboratories write them, each with its map: the same motion in other names, units, clocks, files and formats."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.data.importing.truth import COMMANDS, LENGTH, PLACES, signals
from tests.data.made import ACTUATORS, POINTS

PSI, ATM = 6894.757293168, 101325.0


@dataclass(frozen=True)
class Foreign:
    """A laboratory's tables.

    Attributes:
        files: that were written.
        map: text of the map file.
        step: largest time between samples in s of what is measured, and of what is commanded; rounding of what is measured in m.
        runs: names of the runs, in order, with their time in the session at which the truth begins.
        filled: columns that are compared; the others are empty or zero.
        hold: whether commands hold.
        filtered: whether the grid is coarser than the samples.
    """

    files: Sequence[Path]
    map: str
    step: tuple[float, float]
    runs: Mapping[str, int]
    filled: Sequence[str] = (*COMMANDS, *PLACES)
    rounding: float = 1e-9
    hold: bool = False
    filtered: bool = False


LAYOUTS: dict[str, Callable[[Path], Foreign]] = {}


def layout(write: Callable[[Path], Foreign]) -> Callable[[Path], Foreign]:
    LAYOUTS[write.__name__] = write
    return write


def even(rate: float) -> np.ndarray:
    return np.arange(round(LENGTH * rate) + 1) / rate


def jittering(rate: float, seed: int = 0, by: float = 0.3) -> np.ndarray:
    """Times whose steps are off by up to so much of a step."""
    random = np.random.default_rng(seed)
    time = even(rate)
    time[1:-1] += random.uniform(-by, by, len(time) - 2) / rate / 2
    return time


def text(path: Path, columns: Mapping[str, Any], separator: str = ",", decimal: str = ".", **options: Any) -> Path:
    """A table; options: header (False: none), before (lines), behind (a line under the header), encoding, digits."""
    rows = zip(*(np.asarray(values) for values in columns.values()), strict=True)
    digits = options.get("digits", 12)
    lines = [*options.get("before", []), *([separator.join(columns)] if options.get("header", True) else []), *options.get("behind", [])]
    lines += [separator.join(each if isinstance(each, str) else f"{each:.{digits}g}".replace(".", decimal) for each in row) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding=options.get("encoding", "utf-8"))
    return path


def toml(value: Any) -> str:
    return json.dumps(value)


@layout
def german_spreadsheet(folder: Path) -> Foreign:
    """Semicolons and decimal commas, ms, bar, mm."""
    time = even(50)
    found = signals(time)
    columns = {"Zeit": 1e3 * time, **{f"p{a}": found[f"pressure_{a}_Pa"] / 1e5 for a in ACTUATORS}}
    columns |= {f"F{a}": found[f"tension_{a}_N"] for a in ACTUATORS} | {f"M{n[1]}{n[3].upper()}": 1e3 * found[n] for n in PLACES}
    given = """robot = "kang2017"
csv = { separator = ";", decimal = "," }
time = { column = "Zeit", unit = "ms" }
pressure = { columns = "p{module}{actuator}", unit = "bar" }
tension = { columns = "F{name}", unit = "N" }
position = { columns = "M{point}{AXIS}", unit = "mm" }
"""
    return Foreign([text(folder / "messung.csv", columns, ";", ",")], given, (0.02, 0.02), {"messung": 0})


@layout
def pneumatic_only_with_quaternions(folder: Path) -> Foreign:
    """Tabs, units in the names, kPa, cm, no tendons, an orientation beside every place."""
    time = even(60)
    found = signals(time)
    columns = {"time (s)": time} | {f"valve{k} (kPa)": found[f"pressure_{a}_Pa"] / 1e3 for k, a in enumerate(ACTUATORS)}
    for name in POINTS:
        columns |= {f"{name}/{axis} (cm)": 1e2 * found[f"{name}_{axis}_m"] for axis in "xyz"}
        columns |= {f"{name}/q{axis}": np.full(len(time), 0.5) for axis in "wxyz"}
    given = """robot = "kang2017"
time = { column = "time (s)" }
pressure = { columns = "valve{n0} (kPa)", unit = "kPa" }
position = { columns = "{name}/{axis} (cm)", unit = "cm" }
"""
    filled = (*COMMANDS[:6], *PLACES)
    return Foreign([text(folder / "log.tsv", columns, "\t")], given, (1 / 60, 1 / 60), {"log": 0}, filled)


@layout
def tip_alone_without_header(folder: Path) -> Foreign:
    """Bars between, no names, psi, the tip alone, time that jitters."""
    time = jittering(55)
    found = signals(time)
    columns = {"t": time} | {a: found[f"pressure_{a}_Pa"] / PSI for a in ACTUATORS}
    columns |= {n: found[n] for n in PLACES[-3:]} | {f"q{k}": np.full(len(time), 0.5) for k in range(4)}
    given = """robot = "kang2017"
csv = { separator = "|", header = 0 }
time = { column = 1 }
pressure = { columns = [2, 3, 4, 5, 6, 7], unit = "psi" }
position = { of = ["s4"], columns = [8, 9, 10] }
"""
    return Foreign(
        [text(folder / "trial.txt", columns, "|", header=False)], given, (1.3 / 55, 1.3 / 55), {"trial": 0}, (*COMMANDS[:6], *PLACES[-3:])
    )


@layout
def camera_export(folder: Path) -> Foreign:
    """Lines before the header, a line of units under it, names that stand twice, y upwards, 120 frames a second."""
    time = even(120)
    found = signals(time)
    rows = [time, *(found[n] for n in COMMANDS)]
    names = ["Time", *(f"u{k}" for k in range(12))]
    for name in POINTS:
        x, y, z = (1e3 * found[f"{name}_{axis}_m"] for axis in "xyz")
        rows += [-x, z, y]  # theirs: to the left, upwards, to the back
        names += ["X", "Y", "Z"]
    body = [",".join(f"{value:.12g}" for value in row) for row in zip(*rows, strict=True)]
    head = [
        "Format Version,1.23,Take Name,run 7",
        "",
        ",".join(["Name", "", "", "markers"]),
        ",".join(names),
        ",".join(["s"] + ["-"] * 12 + ["mm"] * 12),
    ]
    (folder / "take.csv").write_text("\n".join(head + body) + "\n", encoding="utf-8")
    given = f"""robot = "kang2017"
rate_hz = 60
csv = {{ header = 4, first = 6 }}
frame = {{ axes = ["-x", "z", "y"] }}
time = {{ column = "Time" }}
pressure = {{ columns = "u{{n0}}" }}
tension = {{ columns = {toml([f"u{k}" for k in range(6, 12)])} }}
position = {{ columns = {toml(list(range(14, 26)))}, unit = "mm" }}
"""
    return Foreign([folder / "take.csv"], given, (1 / 120, 1 / 120), {"take": 0}, filtered=True)


@layout
def two_files_a_run(folder: Path) -> Foreign:
    """Valves 20 times a second in ms, a tracker 240 times in s since 1970; two runs."""
    files = []
    for number, run in enumerate(("a", "b")):
        slow, fast = even(20), even(240)
        first, second = signals(slow, number), signals(fast, number)
        origin = 1.7e9 + 100 * number
        valves = {"stamp_ms": 1e3 * (origin + slow)} | {n: first[n] for n in COMMANDS}
        files.append(text(folder / f"{run}_valves.csv", valves, digits=16))
        tracker = {"epoch": origin + fast} | {f"p{n[1]}.{n[3]}": 1e3 * second[n] for n in PLACES}
        files.append(text(folder / f"{run}_tracker.csv", tracker, digits=16))
    given = """robot = "kang2017"
rate_hz = 50
validation = ["b"]
time = [
  { file = "*_valves.csv", column = "stamp_ms", unit = "ms" },
  { file = "*_tracker.csv", column = "epoch" },
]
pressure = { file = "*_valves.csv", columns = "pressure_{name}_Pa" }
tension = { file = "*_valves.csv", columns = "tension_{name}_N" }
position = { file = "*_tracker.csv", columns = "p{point}.{axis}", unit = "mm" }
"""
    return Foreign(files, given, (1 / 240, 1 / 20), {"a": 0, "b": 1}, filtered=True, rounding=1e-6)


@layout
def trials_in_one_file(folder: Path) -> Foreign:
    """A column that names the trial; tension in grams, pressures absolute."""
    time = even(50)
    parts = [signals(time, run) for run in range(3)]
    columns: dict[str, Any] = {
        "trial": np.repeat(["one", "two", "three"], len(time)),
        "t": np.concatenate([time + 10 * k for k in range(3)]),
    }
    columns |= {n: np.concatenate([each[n] for each in parts]) for n in (*COMMANDS, *PLACES)}
    for a in ACTUATORS:
        columns[f"pressure_{a}_Pa"] = (columns[f"pressure_{a}_Pa"] + ATM) / 1e2
        columns[f"tension_{a}_N"] = columns[f"tension_{a}_N"] / 9.80665e-3
    given = """robot = "kang2017"
split = "trial"
validation = ["*_two"]
time = { column = "t" }
pressure = { columns = "pressure_{name}_Pa", unit = "hPa", offset = -1013.25 }
tension = { columns = "tension_{name}_N", unit = "gf" }
position = { columns = "{name}_{axis}_m" }
"""
    return Foreign([text(folder / "day.csv", columns)], given, (0.02, 0.02), {"day_one": 0, "day_two": 1, "day_three": 2})


@layout
def stacked_runs(folder: Path) -> Foreign:
    """Time begins anew where a run does; lost samples are -9999; names of other actuators."""
    time = even(40)
    parts = [signals(time, run) for run in range(2)]
    columns = {"t": np.tile(time, 2)} | {n: np.concatenate([each[n] for each in parts]) for n in (*COMMANDS, *PLACES)}
    for name in PLACES[3:6]:
        columns[name] = np.where(np.isin(np.arange(2 * len(time)), [100, 101]), -9999.0, columns[name])
    given = """robot = "kang2017"
split = "t"
time = { column = "t" }
pressure = { columns = "pressure_{name}_Pa" }
tension = { columns = "tension_{name}_N" }
position = { columns = "{name}_{axis}_m", missing = [-9999] }
"""
    return Foreign([text(folder / "all.csv", columns)], given, (1 / 40, 1 / 40), {"all_1": 0, "all_2": 1})


@layout
def dates_in_latin_1(folder: Path) -> Foreign:
    """Date and time as text, a degree sign that is not UTF-8, an extra column of temperature."""
    time = even(50)
    found = signals(time)
    stamps = np.datetime64("2026-11-20T10:00:00") + (1e6 * time).round().astype("timedelta64[us]")
    columns: dict[str, Any] = {"datetime": np.datetime_as_string(stamps, unit="us")} | {n: found[n] for n in (*COMMANDS, *PLACES)}
    columns["T [°C]"] = 20 + time
    given = """robot = "kang2017"
csv.encoding = "latin-1"
time = { column = "datetime", unit = "iso" }
pressure = { columns = "pressure_{name}_Pa" }
tension = { columns = "tension_{name}_N" }
position = { columns = "{name}_{axis}_m" }
extra.temperature_C = { column = "T [°C]" }
"""
    return Foreign([text(folder / "dated.csv", columns, encoding="latin-1")], given, (0.02, 0.02), {"dated": 0})


@layout
def parquet(folder: Path) -> Foreign:
    """Instants of pandas, MPa, mm."""
    import pandas as pd
    import pytest

    pytest.importorskip("pyarrow")
    time = even(100)
    found = signals(time)
    columns: dict[str, Any] = {"when": pd.Timestamp("2026-11-20T10:00:00Z") + pd.to_timedelta(time, unit="s")}
    columns |= {f"p_{a}": found[f"pressure_{a}_Pa"] / 1e6 for a in ACTUATORS} | {f"f_{a}": found[f"tension_{a}_N"] for a in ACTUATORS}
    columns |= {f"{n[:4]}": 1e3 * found[n] for n in PLACES}
    pd.DataFrame(columns).to_parquet(folder / "run.parquet", engine="pyarrow")
    given = """robot = "kang2017"
time = { column = "when" }
pressure = { columns = "p_{name}", unit = "MPa" }
tension = { columns = "f_{name}" }
position = { columns = "{name}_{axis}", unit = "mm" }
"""
    return Foreign([folder / "run.parquet"], given, (0.01, 0.01), {"run": 0}, rounding=1e-6)


@layout
def matlab_structure(folder: Path) -> Foreign:
    """A structure with matrices, lost samples as zeros, each module's pressures a matrix of columns."""
    from scipy.io import savemat

    time = even(100)
    found = signals(time)
    places = np.array([found[n] for n in PLACES]).T
    places[[150, 151, 152], 3:6] = 0.0
    log = {"t": time[:, None], "cmd": {"p": np.array([found[n] for n in COMMANDS[:6]]).T, "f": np.array([found[n] for n in COMMANDS[6:]])}}
    savemat(folder / "run.mat", {"log": {**log, "pos": places}})
    given = """robot = "kang2017"
time = { column = "log.t" }
pressure = { columns = "log.cmd.p_{n}" }
tension = { columns = "log.cmd.f_{n}" }
position = { columns = "log.pos_{n}", missing = [0] }
"""
    return Foreign([folder / "run.mat"], given, (0.01, 0.01), {"run": 0})


@layout
def hdf5_of_two_clocks(folder: Path) -> Foreign:
    """Groups of two clocks in one file, µs as integers."""
    import pytest

    h5py = pytest.importorskip("h5py")
    slow, fast = even(50), jittering(150, seed=3)
    first, second = signals(slow), signals(fast)
    with h5py.File(folder / "run.h5", "w") as file:
        file["drive/t"] = (1e6 * slow).round().astype(np.int64)
        file["drive/u"] = np.array([first[n] for n in COMMANDS]).T
        file["camera/t"] = (1e6 * fast).round().astype(np.int64)
        file["camera/pos"] = np.array([second[n] for n in PLACES]).T.reshape(-1, 4, 3)
    given = f"""robot = "kang2017"
rate_hz = 50
time = {{ column = "drive/t", unit = "us" }}
pressure = {{ columns = "drive/u_{{n}}" }}
tension = {{ columns = {toml([f"drive/u_{k}" for k in range(7, 13)])} }}
position = {{ columns = "camera/pos_{{n}}", time = "camera/t" }}
"""
    return Foreign([folder / "run.h5"], given, (1.3 / 150, 0.02), {"run": 0}, filtered=True, rounding=1e-6)


def _bag(folder: Path, storage: str) -> Path:
    """Valves that speak when they change, all pressures in one message; poses of the four points 100 times a second."""
    import pytest

    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    array, layout_of = kinds["std_msgs/msg/Float64MultiArray"], kinds["std_msgs/msg/MultiArrayLayout"]
    poses, pose = kinds["geometry_msgs/msg/PoseArray"], kinds["geometry_msgs/msg/Pose"]
    point, turn = kinds["geometry_msgs/msg/Point"], kinds["geometry_msgs/msg/Quaternion"]
    header, stamp = kinds["std_msgs/msg/Header"], kinds["builtin_interfaces/msg/Time"]
    origin = 1_700_000_000_000_000_000
    path = folder / "bag"
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage]) as bag:
        valves = bag.add_connection("/valves", array.__msgtype__, typestore=store)
        markers = bag.add_connection("/markers", poses.__msgtype__, typestore=store)
        slow, fast = even(40), even(100)
        commands = np.array([signals(slow)[n] for n in COMMANDS]).T
        places = np.array([signals(fast)[n] for n in PLACES]).T.reshape(-1, len(POINTS), 3).tolist()
        for moment, values in zip(slow, commands, strict=True):
            message = array(layout=layout_of(dim=[], data_offset=0), data=values.copy())
            bag.write(valves, origin + round(1e9 * moment), store.serialize_cdr(message, array.__msgtype__))
        for moment, at in zip(fast, places, strict=True):
            when = origin + round(1e9 * moment)
            placed = [pose(point(*each), turn(0.0, 0.0, 0.0, 1.0)) for each in at]
            message = poses(header(stamp(when // 10**9, when % 10**9), "world"), placed)
            bag.write(markers, when, store.serialize_cdr(message, poses.__msgtype__))
    return path


BAG = f"""robot = "kang2017"
rate_hz = 50
pressure = {{ columns = "/valves/data/{{n}}", between = "hold" }}
tension = {{ columns = {toml([f"/valves/data/{k}" for k in range(7, 13)])}, between = "hold" }}
position = {{ columns = "/markers/poses/{{point}}/position/{{axis}}", time = "/markers/header/stamp" }}
"""


@layout
def ros_2_bag(folder: Path) -> Foreign:
    """A folder with SQLite, commands that hold."""
    path = _bag(folder, "SQLITE3")
    return Foreign([path], BAG, (0.01, 1 / 40), {"bag": 0}, hold=True, filtered=True, rounding=2e-6)


@layout
def mcap(folder: Path) -> Foreign:
    """The same in one MCAP file."""
    (path,) = _bag(folder, "MCAP").glob("*.mcap")
    return Foreign([path], BAG, (0.01, 1 / 40), {path.stem: 0}, hold=True, filtered=True, rounding=2e-6)


@layout
def rows_without_time(folder: Path) -> Foreign:
    """Blanks between, no time but a rate, a weight on the tip, gauges beside the commands, lost samples as words."""
    time = even(80)
    found = signals(time)
    columns: dict[str, Any] = {n: found[n] for n in (*COMMANDS, *PLACES)}
    columns |= {f"gauge{a}": found[f"pressure_{a}_Pa"] * 1.01 for a in ACTUATORS}
    columns["s2_x_m"] = [("lost" if k in (200, 201) else f"{value:.12g}") for k, value in enumerate(columns["s2_x_m"])]
    given = """robot = "kang2017"
csv = { separator = " " }
time = { rate_hz = 80 }
pressure = { columns = "pressure_{name}_Pa" }
pressure_measured = { columns = "gauge{name}" }
tension = { columns = "tension_{name}_N" }
position = { columns = "{name}_{axis}_m", missing = ["lost"] }
"""
    return Foreign([text(folder / "plain.dat", columns, " ")], given, (1 / 80, 1 / 80), {"plain": 0})

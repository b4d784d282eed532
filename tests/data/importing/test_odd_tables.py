"""Odd tables as loggers really write them: codes for lost samples, clocks that are none, header rows, cut rows; advice that works."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tepm_opt.data.importing.advice import merge_maps
from tepm_opt.errors import InputError
from tepm_opt.jobs.import_data import ImportRun, run_import, suggest_map
from tests.data.importing.layouts import even, text
from tests.data.importing.test_refusals import entries, given, write_map
from tests.data.importing.truth import COMMANDS, PLACES, signals

TIP = PLACES[9:12]
RATE = 50
COUNT = 6 * RATE + 1


@dataclass(frozen=True)
class Odd:
    """A table, a map of it, and the words that are printed.

    Attributes:
        file: the table.
        map: content of the map file.
        says: words of the refusal.
        notes: words of the notes after all proposals.
        answer: entries of a person, where the refusal asks.
        lost: rows of the tip that are empty in the end; None: not compared.
        quick: whether the data set's motion is compared with the truth.
    """

    file: Path
    map: Mapping[str, Any]
    says: Sequence[str] = ()
    notes: Sequence[str] = ()
    answer: str = ""
    lost: int | None = 0
    quick: bool = True


def bag_without_definition(folder: Path) -> Path:
    """A ROS 2 bag with valves in a message of its own package, whose definition is taken out."""
    import sqlite3

    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg("float64[6] kpa\n", "lab_msgs/msg/Valves"))
    valve, poses = store.types["lab_msgs/msg/Valves"], store.types["geometry_msgs/msg/PoseArray"]
    pose, point, turn = (store.types[f"geometry_msgs/msg/{name}"] for name in ("Pose", "Point", "Quaternion"))
    header, stamp = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    path, origin = folder / "bag", 1_700_000_000_000_000_000
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as bag:
        valves = bag.add_connection("/valves", valve.__msgtype__, typestore=store)
        markers = bag.add_connection("/markers", poses.__msgtype__, typestore=store)
        for k in range(COUNT):
            when = origin + k * 20_000_000
            message = valve(np.full(6, 50 + 30 * np.sin(k / 40)))
            bag.write(valves, when, store.serialize_cdr(message, valve.__msgtype__))
            placed = [pose(point(0.01 * np.sin(k / 40), 0.0, 0.1 * (i + 1) - 0.05), turn(0.0, 0.0, 0.0, 1.0)) for i in range(4)]
            tracked = poses(header(stamp(when // 10**9, when % 10**9), "g"), placed)
            bag.write(markers, when, store.serialize_cdr(tracked, poses.__msgtype__))
    for file in path.glob("*.db3"):
        with sqlite3.connect(file) as base:
            base.execute("DELETE FROM message_definitions")
    return path


ODD: dict[str, Callable[[Path], Odd]] = {}


def add(name: str, write: Callable[[Path], Odd]) -> None:
    assert name not in ODD
    ODD[name] = write


def motion() -> dict[str, Any]:
    found = signals(even(RATE))
    return {"t": even(RATE)} | {n: found[n] for n in (*COMMANDS, *PLACES)}


def coded(code: float, columns: Sequence[str] = TIP, rows: Sequence[int] = (40, 41, 90, 133, 200)) -> Callable[[Path], Odd]:
    """Rows in which a program wrote a code."""

    def write(folder: Path) -> Odd:
        table = motion()
        for name in columns:
            table[name] = np.where(np.isin(np.arange(COUNT), rows), code, table[name])
        says = [f"position.missing = [{int(code) if abs(code) < 1e15 else code}]"]
        says += ["the same three numbers", f"in {len(rows)} rows", "a code for lost samples?"] if code else ["a code for a lost sample?"]
        return Odd(text(folder / "a.csv", table), given(), says, lost=len(rows))

    return write


for code in (-9999.0, 9999.0, -999.0, 1e6, -1e6, -3.697314e28, 1e30, 65535.0, -32768.0, 2147483647.0, 99999.0, 777.0, 0.0):
    add(f"code {code:g}", coded(code))
add("code at the start", coded(-9999.0, rows=range(12)))
add("code at the end", coded(-9999.0, rows=range(COUNT - 12, COUNT)))
add("code in two points", coded(1e6, PLACES[6:]))


def two_codes(folder: Path) -> Odd:
    table = motion()
    for name in TIP:
        table[name][[20, 21, 22]], table[name][[60, 61]] = -9999.0, -3.697314e28
    return Odd(text(folder / "a.csv", table), given(), ["-3.697314e+28 and -9999, in 5 rows"], lost=5)


add("two codes", two_codes)


def gauge_code(folder: Path) -> Odd:
    table = motion() | {"gauge": signals(even(RATE))[COMMANDS[0]].copy()}
    table["gauge"][[30, 31, 32, 77]] = -9999.0
    changed = given(pressure_measured={"columns": ["gauge"], "of": ["11"]})
    return Odd(text(folder / "a.csv", table), changed, ["pressure_measured.missing = [-9999]", "the same number"])


add("code of a gauge", gauge_code)


def counter(period: float, unit: str, one: float, start: float) -> Callable[[Path], Odd]:
    """Time as a counter that begins again."""

    def write(folder: Path) -> Odd:
        table = motion()
        table["t"] = np.round((start + table["t"]) / one, 3) % period
        return Odd(
            text(folder / "a.csv", table),
            given(time={"unit": unit}),
            [f"time.rolls_over_at = {period:g}" if period < 1e6 else "time.rolls_over_at", "rolls over"],
            ["counted on"],
        )

    return write


add("each second in ms", counter(1000, "ms", 1e-3, 0.82))
add("each second in s", counter(1, "s", 1.0, 0.34))
add("each minute", counter(60, "s", 1.0, 56.5))
add("each hour", counter(3600, "s", 1.0, 3597.1))
add("at midnight in s", counter(86400, "s", 1.0, 86397.0))
add("at midnight in ms", counter(86400000, "ms", 1e-3, 86397.0))
add("16 bits of ms", counter(65536, "ms", 1e-3, 62.5))
add("32 bits of ms", counter(2**32, "ms", 1e-3, 4294964.1))
add("32 bits of us", counter(2**32, "us", 1e-6, 4292.1))


def parts(names: Sequence[str], column: str, start: float = 0.821, answer: str = "") -> Callable[[Path], Odd]:
    """A time in several columns, of which the map names one."""

    def write(folder: Path) -> Odd:
        table = motion()
        ms = np.round(1e3 * (table.pop("t") + start)).astype(int)
        every = {"h": 4 + ms // 3600000, "min": ms // 60000 % 60, "s": ms // 1000 % 60, "ms": ms % 1000}
        units = list(every)[-len(names) :]
        table = {name: every[unit] for name, unit in zip(names, units, strict=True)} | table
        return Odd(text(folder / "a.csv", table), given(time={"column": column}), ["is a part of a time", "time.column = ["])

    return write


add("hours to ms, seconds named", parts(["Hour", "Minutes", "Seconds", "ms"], "Seconds"))
add("hours to ms, ms named", parts(["Hour", "Minute", "Second", "Millisecond"], "Millisecond"))
add("minutes to ms over an hour", parts(["min", "sec", "msec"], "sec", 3597.3))
add("seconds and ms", parts(["s", "ms"], "ms", 57.2))


def frames(before: Sequence[str], asked: str, answer: str = "", name: str = "Frame") -> Callable[[Path], Odd]:
    def write(folder: Path) -> Odd:
        table = motion()
        table = {name: np.arange(COUNT)} | {k: v for k, v in table.items() if k != "t"}
        form = {"csv": {"header": len(before) + 1}} if before else {}
        return Odd(
            text(folder / "a.csv", table, before=before), given(time={"column": name}, **form), ["counts rows", asked], answer=answer
        )

    return write


add("frames without a rate", frames([], "how many rows a second?", "time.rate_hz = 50"))
add("samples without a rate", frames([], "how many rows a second?", "time.rate_hz = 50", "Sample #"))
add("frames with a stated rate", frames(["Capture Frame Rate,100.0,Export Frame Rate,50.0"], "time.rate_hz = 50"))
add("frames with a rate in a comment", frames(["# sample rate: 50 Hz"], "time.rate_hz = 50"))
add("frames with a frequency", frames(["NO_OF_FRAMES,301", "FREQUENCY,50"], "time.rate_hz = 50"))


def frames_beside_time(folder: Path) -> Odd:
    return Odd(text(folder / "a.csv", {"Frame": np.arange(COUNT)} | motion()), given(time={"column": "Frame"}), ['time.column = "t"'])


add("frames beside a time", frames_beside_time)


def dated(form: str, says: Sequence[str], answer: str = "", start: str = "2026-03-02T23:59:57") -> Callable[[Path], Odd]:
    def write(folder: Path) -> Odd:
        table = motion()
        stamps = [np.datetime64(start, "ms") + np.timedelta64(round(1e3 * t), "ms") for t in table["t"]]
        table["t"] = [stamp.item().strftime(form) for stamp in stamps]
        return Odd(text(folder / "a.csv", table), given(), says, answer=answer)

    return write


add("dates that may be either", dated("%d/%m/%Y %H:%M:%S.%f", ["day or the month first", '"month first"'], 'time.date = "day first"'))
add("dates with points", dated("%d.%m.%Y %H:%M:%S.%f", ["'02.03.2026 23:59:57.000000'"], 'time.date = "day first"'))
add("American dates", dated("%m/%d/%Y %I:%M:%S.%f %p", ["month first"], 'time.date = "month first"'))
add("a day beyond 12", dated("%d/%m/%Y %H:%M:%S.%f", [], start="2026-03-27T11:00:00"))
add("times of day over midnight", dated("%H:%M:%S.%f", []))


def rows_of(table: Mapping[str, Any]) -> list[str]:
    return [",".join(f"{value:.9g}" for value in row) for row in zip(*table.values(), strict=True)]


def written(folder: Path, head: Sequence[str], body: Sequence[str], end: str = "\n") -> Path:
    (folder / "a.csv").write_text("\n".join([*head, *body]) + end)
    return folder / "a.csv"


def cut(first: int, last: int) -> Callable[[Path], Odd]:
    """A serial log that begins and ends within a line."""

    def write(folder: Path) -> Odd:
        body = rows_of(motion())
        if first:
            body[0] = body[0].split(",", first)[-1]
        if last:
            body[-1] = body[-1].rsplit(",", last)[0]
        says = [f"line 2 has {25 - first} of 25 fields"] * bool(first) + [f"line 302 has {25 - last} of 25 fields"] * bool(last)
        path = written(folder, [",".join(motion())], body, "")
        return Odd(path, given(), [*says, 'csv.short_rows = "ends"'], ["left out"])

    return write


add("first row cut", cut(13, 0))
add("last row cut", cut(0, 11))
add("both cut", cut(17, 20))


def header_named_too_late(folder: Path) -> Odd:
    return Odd(text(folder / "a.csv", motion()), given(csv={"header": 2}), ["line 2", "csv.header = 1"])


add("header named too late", header_named_too_late)


def fragment(folder: Path) -> Odd:
    body = rows_of(motion())
    body[0] = "796914," + body[0].partition(",")[2]
    return Odd(written(folder, [",".join(motion())], body), given(), ["line 2 is cut off?", "csv.first = 3"])


add("a fragment as time", fragment)


def short_within(answer: str) -> Callable[[Path], Odd]:
    def write(folder: Path) -> Odd:
        body = rows_of(motion())
        for row in (70, 71, 120):
            body[row] = body[row].rsplit(",", 3)[0]
        says = ["lines 72, 73, 122: 22 of 25 fields; 3 of 301 rows are short"]
        return Odd(written(folder, [",".join(motion())], body), given(), says, answer=answer, lost=3 if "empty" in answer else None)

    return write


add("short rows within, filled", short_within('csv.short_rows = "empty"'))
add("short rows within, left out", short_within('csv.short_rows = "all"'))

GROUPS = ["", *["cmd"] * 12, *(name for k in range(4) for name in (f"marker {k + 1}", "", ""))]
AXES = ["t", *COMMANDS, *["X", "Y", "Z"] * 4]
JOINED = {
    "pressure": {"columns": "cmd pressure_{name}_Pa"},
    "tension": {"columns": "cmd tension_{name}_N"},
    "position": {"columns": "marker {point} {AXIS}"},
}


def grouped(above: Sequence[str], between: Sequence[str] = (), below: Sequence[str] = ()) -> Callable[[Path], Odd]:
    def write(folder: Path) -> Odd:
        path = written(folder, [*above, ",".join(GROUPS), *between, ",".join(AXES), *below], rows_of(motion()))
        header = len(above) + len(between) + 2
        return Odd(path, given(**JOINED), [f"csv.header = {header}", f"csv.groups = {len(above) + 1}"])

    return write


add("two header rows", grouped([]))
add("two header rows behind a key", grouped(["Version,1.2,Rate,50"]))
add("two header rows and units", grouped([], below=[",".join(["s", *["Pa"] * 6, *["N"] * 6, *["m"] * 12])]))
add("header rows with a type between", grouped(["Version,1,a,b,c"], [",".join(["", *["Type"] * 24])]))


def of_kinds(folder: Path) -> Odd:
    table = motion()
    lines = []
    for k in range(COUNT):
        lines.append(",".join(["P", *(f"{table[n][k]:.9g}" for n in ("t", *COMMANDS))]))
        lines.append(",".join(["T", *(f"{table[n][k]:.9g}" for n in ("t", *PLACES)), "0"]))
    (folder / "a.csv").write_text("\n".join(lines) + "\n")
    columns = {
        "csv": {"header": 0},
        "time": {"column": "T/2"},
        "pressure": {"columns": [f"P/{k}" for k in range(3, 9)], "time": "P/2"},
        "tension": {"columns": [f"P/{k}" for k in range(9, 15)], "time": "P/2"},
        "position": {"columns": [f"T/{k}" for k in range(3, 15)]},
    }
    return Odd(folder / "a.csv", given(**columns), ["rows of 2 kinds", "csv.kinds = true"])


add("rows of two kinds", of_kinds)


def held(rows: Sequence[int], notes: Sequence[str]) -> Callable[[Path], Odd]:
    """A tracker whose samples a faster program wrote several times, with noise."""

    def write(folder: Path) -> Odd:
        table = motion()
        noise = np.random.default_rng(1).normal(0, 1e-5, COUNT)
        kept = np.concatenate([[0], np.cumsum(np.resize(rows, COUNT))])
        own = kept[np.searchsorted(kept, np.arange(COUNT), side="right") - 1]
        for name in PLACES:
            table[name] = (table[name] + noise)[own]
        return Odd(text(folder / "a.csv", table), given(), notes=["a slower sensor of", *notes], quick=False, lost=None)

    return write


add("held for two rows", held([2], ["25 Hz"]))
add("held for five rows", held([5], ["10 Hz"]))
add("held for one or two rows", held([1, 2, 2], ["30 Hz"]))


def led(odd: Odd, folder: Path) -> tuple[str, ImportRun]:
    """The first refusal, and the data set to which its proposals and the person's answer lead."""
    content, first = dict(odd.map), ""
    for _ in range(6):
        try:
            return first, run_import([odd.file], write_map(folder / "map.toml", content))
        except InputError as error:
            first = first or str(error)
            proposed = entries(str(error)) or [odd.answer]
            if proposed == [""] or "\n" in str(error):
                raise
            for entry in proposed:
                content = merge_maps(content, tomllib.loads(entry))
    raise AssertionError(first)


@pytest.mark.parametrize("name", ODD)
def test_every_proposal_leads_to_a_data_set(name: str, tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    odd = ODD[name](tmp_path)
    first, run = led(odd, tmp_path)
    assert not [words for words in odd.says if words not in first], first
    notes = "\n".join(run.notes)
    assert not [words for words in odd.notes if words not in notes], notes
    assert run.dataset is not None
    kept = run.dataset.runs[0]
    seen = np.isfinite(kept.points[:, 3]).all(axis=1)
    if odd.lost is not None:
        assert (~seen).sum() == odd.lost
    if odd.quick:  # where a row is cut off, the run begins a row later
        late = 6.0 - kept.duration if "first" in name or "both" in name or "fragment" in name else 0.0
        late -= 0.02 if "both" in name else 0.0
        assert kept.duration > 5.9
        truth = np.array([signals(kept.time + late)[column] for column in TIP]).T
        assert np.abs(kept.points[:, 3] - truth)[seen].max() < 1e-5


def test_there_are_many() -> None:
    assert len(ODD) >= 40


GUESSED = ["hours to ms, seconds named", "each second in ms", "frames with a stated rate", "two header rows", "both cut", "code -9999"]


@pytest.mark.parametrize("name", GUESSED)
def test_a_guess_needs_no_more(name: str, tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    odd = ODD[name](tmp_path)
    guess = suggest_map([odd.file])
    assert "still open" not in guess
    _, run = led(Odd(odd.file, tomllib.loads(guess)), tmp_path)
    assert run.rate == pytest.approx(RATE, rel=1e-3)
    assert run.dataset is not None
    assert run.dataset.runs[0].duration > 5.9


def test_a_question_stands_in_the_guess(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    assert "# still open: " in suggest_map([ODD["frames without a rate"](tmp_path).file])


def test_advice_that_leads_nowhere_is_not_printed(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    path = written(tmp_path, ["a;b;c"], ["1;2;3", "2;3;4", "3;4;5"])
    with pytest.raises(InputError) as caught:
        run_import([path], write_map(tmp_path / "map.toml", given(position={"columns": [1, 2, 3], "of": ["s4"]})))
    assert entries(str(caught.value)) == []
    assert "no entry of the map mends it" in str(caught.value)


def test_a_slow_sensor_is_not_filtered_as_if_it_were_new(tmp_path: Path) -> None:
    """Held for five rows at 50 Hz: the data set has the sensor's 10 Hz, and its samples as they were."""
    pytest.importorskip("pandas")
    odd = ODD["held for five rows"](tmp_path)
    run = run_import([odd.file], write_map(tmp_path / "map.toml", odd.map))
    assert run.rate == pytest.approx(10.0)
    assert run.dataset is not None
    table = np.genfromtxt(odd.file, delimiter=",", names=True)
    assert run.dataset.runs[0].points[:, 3, 0] == pytest.approx(table[TIP[0]][::5], abs=1e-9)


def test_samples_at_rest_are_not_held(tmp_path: Path) -> None:
    """Two seconds at rest without noise, counts of a coarse gauge, and zeros at the start are no codes and no slow sensor."""
    pytest.importorskip("pandas")
    table = motion()
    table["gauge"] = np.round(table[COMMANDS[0]] / 500) * 500
    table["gauge_2"] = np.where(even(RATE) < 1, 0.0, 1.5e5)
    changed = given(pressure_measured={"columns": ["gauge", "gauge_2"], "of": ["11", "12"]})
    run = run_import([text(tmp_path / "a.csv", table)], write_map(tmp_path / "map.toml", changed))
    assert not [note for note in run.notes if "slower" in note]
    assert run.rate == RATE


def test_messages_without_a_definition(tmp_path: Path) -> None:
    """The topic, the type, the number of messages and where the definition goes; with it they are read."""
    pytest.importorskip("rosbags")
    bag = bag_without_definition(tmp_path)
    content = {
        "robot": "kang2017",
        "rate_hz": 50,
        "pressure": {"columns": "/valves/kpa/{n}", "unit": "kPa", "between": "hold"},
        "position": {"columns": "/markers/poses/{point}/position/{axis}"},
    }
    says = "topic '/valves': 301 messages of type lab_msgs/msg/Valves cannot be decoded"
    with pytest.raises(InputError, match=says):
        suggest_map([bag])
    with pytest.raises(InputError, match=says) as caught:
        run_import([bag], write_map(tmp_path / "map.toml", content))
    file = Path(str(caught.value).rpartition("valid: its definition as ")[2])
    file.parent.mkdir(parents=True)
    file.write_text("float64[6] kpa\n")
    run = run_import([bag], write_map(tmp_path / "map.toml", content))
    assert run.dataset is not None
    assert run.dataset.runs[0].inputs[:, 0].max() == pytest.approx(80e3, rel=1e-3)

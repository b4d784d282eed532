"""Data sets with one thing wrong: each is one clear line that says where, what, and what would be right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tepm_opt.cli import run as tepm
from tepm_opt.data.checks.dataset import check_reading
from tepm_opt.data.datasets import read_dataset, read_folder, write_dataset
from tepm_opt.data.run import Run
from tepm_opt.errors import InputError
from tepm_opt.jobs.discrepancy import checked_dataset
from tepm_opt.models.channels import check
from tests.data.made import CHANNELS, make_dataset

TOML, STEPS = "dataset.toml", "steps.csv"


@dataclass(frozen=True)
class Case:
    """A fault: what makes it, the line that names it, whether a strict reader refuses the data set too."""

    spoil: Callable[[Path], None]
    file: str
    line: str
    channel: str = ""
    refused: bool = False
    unreadable: bool = False
    severity: str = "error"


def text(file: str, old: str, new: str, count: int = 1) -> Callable[[Path], None]:
    """Replace text in a file."""

    def spoil(folder: Path) -> None:
        content = (folder / file).read_text()
        assert old in content
        (folder / file).write_text(content.replace(old, new, count))

    return spoil


def lines(change: Callable[[list[str]], list[str]]) -> Callable[[Path], None]:
    """Change the lines of steps.csv."""

    def spoil(folder: Path) -> None:
        kept = (folder / STEPS).read_text().splitlines()
        (folder / STEPS).write_text("\n".join(change(kept)) + "\n")

    return spoil


def values(change: Callable[[Run], dict[str, np.ndarray]]) -> Callable[[Path], None]:
    """Change arrays of steps.csv."""

    def spoil(folder: Path) -> None:
        dataset = read_dataset(folder)
        changed = replace(dataset.runs[0], **change(dataset.runs[0]))
        write_dataset(replace(dataset, runs=(changed, dataset.runs[1])), folder, overwrite=True)

    return spoil


def points(change: Callable[[np.ndarray], object]) -> Callable[[Path], None]:
    """Change the points (rows, points, 3) of steps.csv in place."""

    def changed(run: Run) -> dict[str, np.ndarray]:
        copy = run.points.copy()
        change(copy)
        return {"points": copy}

    return values(changed)


def inputs(change: Callable[[np.ndarray], object]) -> Callable[[Path], None]:
    """Change the inputs (rows, 12) of steps.csv in place."""

    def changed(run: Run) -> dict[str, np.ndarray]:
        copy = run.inputs.copy()
        change(copy)
        return {"inputs": copy}

    return values(changed)


def swapped(array: np.ndarray, one: int, other: int) -> None:
    array[:, [one, other]] = array[:, [other, one]]


def assign(array: np.ndarray, where: object, value: object) -> None:
    array[where] = value  # type: ignore[index]


def dropped(kept: list[str], first: int, end: int) -> list[str]:
    return kept[:first] + kept[end:]


def without(kept: list[str], column: str) -> list[str]:
    k = kept[0].split(",").index(column)
    return [",".join(part for j, part in enumerate(line.split(",")) if j != k) for line in kept]


def swing(run: Run) -> dict[str, np.ndarray]:
    moved = run.points.copy()
    moved[:, :, 0] += 0.01 * np.exp(-0.25 * run.time)[:, None] * np.sin(2 * np.pi * 0.9 * run.time)[:, None] * np.arange(1, 5) / 4
    return {"points": moved}


def shake(run: Run) -> dict[str, np.ndarray]:
    """A stand that moves by as much as `swing`, and robot and stand alike."""
    return {"points": run.points + [0.01, 0.0, 0.0] * np.sin(2 * np.pi * 0.9 * run.time)[:, None, None]}


CASES = {
    # dataset.toml
    "no dataset.toml": Case(lambda f: (f / TOML).unlink(), TOML, "has no dataset.toml", unreadable=True),
    "not TOML": Case(text(TOML, "[[runs]]", "[[runs]"), TOML, "not valid TOML: Expected ']]'", unreadable=True),
    "not text": Case(lambda f: (f / TOML).write_bytes(b"\xff\xfe\x00"), TOML, "is not a text file (UTF-8)", unreadable=True),
    "unknown key": Case(
        text(TOML, "sample_rate_hz", "sample_rate = 50\nsample_rate_hz"),
        TOML,
        "unknown key 'sample_rate': did you mean 'sample_rate_hz'?",
        refused=True,
    ),
    "missing key": Case(text(TOML, 'robot = "kang2017"\n', ""), TOML, "missing key 'robot'; valid: a built-in robot or the", refused=True),
    "no rate": Case(text(TOML, "sample_rate_hz = 50.0\n", ""), TOML, "missing key 'sample_rate_hz'", refused=True),
    "rate of zero": Case(text(TOML, "sample_rate_hz = 50.0", "sample_rate_hz = 0"), TOML, "sample_rate_hz = 0: ", refused=True),
    "noise in mm": Case(
        text(TOML, "noise_m = 0.0003", "noise_m = 0.3"),
        TOML,
        "0.3: input should be less than or equal to 0.1; valid: 0 … 0.1 m",
        refused=True,
    ),
    "role misspelt": Case(
        text(TOML, '"validation"', '"valdation"'), TOML, "runs entry 2: unknown role 'valdation': did you mean 'validation'?", refused=True
    ),
    "file listed twice": Case(text(TOML, "other.csv", STEPS), TOML, "runs: 'steps.csv' is listed twice", refused=True),
    "file outside": Case(text(TOML, "other.csv", "../other.csv"), TOML, "'../other.csv' is not in the folder", refused=True),
    "unknown robot": Case(
        text(TOML, '"kang2017"', '"kong2017"'),
        TOML,
        "robot 'kong2017' is neither a file nor built in; built in: four_muscles, hanging, kang2017, one_module, slim",
    ),
    "no role validation": Case(
        text(TOML, '"fit"', '"Fit"'), TOML, "unknown role 'Fit': did you mean 'fit'? valid: fit, validation", refused=True
    ),
    # files of runs
    "listed file missing": Case(lambda f: (f / STEPS).unlink(), STEPS, "cannot be read: No such file", refused=True),
    "empty file": Case(lambda f: (f / STEPS).write_text(""), STEPS, "is empty; valid: a header line", refused=True),
    "header only": Case(lines(lambda kept: kept[:1]), STEPS, "has no rows", refused=True),
    "binary": Case(lambda f: (f / STEPS).write_bytes(b"\x89PNG\xff"), STEPS, "is not a CSV text file", refused=True),
    "semicolons": Case(lines(lambda kept: [line.replace(",", ";") for line in kept]), STEPS, "separated by ';'; valid: ','", refused=True),
    "column missing": Case(lines(lambda kept: without(kept, "tension_23_N")), STEPS, "column 'tension_23_N' is missing", refused=True),
    "unit in the header": Case(
        text(STEPS, "pressure_12_Pa", "pressure_12_kPa"), STEPS, "found 'pressure_12_kPa' in its place", refused=True
    ),
    "column twice": Case(text(STEPS, "s2_x_m", "s1_x_m"), STEPS, "column 's1_x_m' stands twice", refused=True),
    "fifth point": Case(text(STEPS, "s4_z_m", "s4_z_m,s5_x_m"), STEPS, "fields, the header has", refused=True),
    "ragged row": Case(
        lines(lambda kept: [*kept[:9], kept[9] + ",1", *kept[10:]]), STEPS, "line 10: 29 fields, the header has 28", refused=True
    ),
    "text in a number": Case(
        lines(lambda kept: [*kept[:4], "0.06 s" + kept[4][4:], *kept[5:]]), STEPS, "line 5: time_s = '0.06 s' is not", refused=True
    ),
    "decimal comma": Case(text(STEPS, "\n0.02,", '\n"0,02",'), STEPS, "line 3: time_s = '0,02' is not a number", refused=True),
    # time
    "time goes back": Case(
        lines(lambda kept: [*kept[:50], kept[60], *kept[50:60], *kept[61:]]), STEPS, "line 52: time goes back", "time_s", True
    ),
    "row twice": Case(lines(lambda kept: [*kept[:60], kept[59], *kept[60:]]), STEPS, "line 61: a copy of the row before", "time_s", True),
    "time stands": Case(
        lines(lambda kept: [*kept[:60], kept[59][:-3] + "123", *kept[60:]]), STEPS, "line 61: the time of the row before", "time_s", True
    ),
    "time empty": Case(
        lines(lambda kept: [*kept[:60], kept[60][kept[60].index(",") :], *kept[61:]]), STEPS, "line 61: no time", "time_s", True
    ),
    "time in ms": Case(values(lambda run: {"time": 1e3 * run.time}), STEPS, "is in milliseconds, not seconds: rows are 20 apart", "time_s"),
    "another rate": Case(values(lambda run: {"time": 0.5 * run.time}), STEPS, "rows come at 100 Hz, sample_rate_hz = 50", "time_s"),
    "rows lost in a step": Case(
        lines(lambda kept: dropped(kept, 70, 100)), STEPS, "30 rows are missing in 1 gaps, the longest 0.62 s", "time_s"
    ),
    # inputs
    "input empty": Case(
        inputs(lambda u: assign(u, (7, 3), np.nan)), STEPS, "line 9: = nan; valid: a finite number", "pressure_21_Pa", True
    ),
    "kPa": Case(
        inputs(lambda u: u.__setitem__((slice(None), slice(6)), u[:, :6] / 1e3)), STEPS, "; valid: 0 … 500000 Pa: in kPa?", "pressure_1"
    ),
    "bar": Case(
        inputs(lambda u: u.__setitem__((slice(None), slice(6)), u[:, :6] / 1e5)), STEPS, "; valid: 0 … 500000 Pa: in bar?", "pressure_1"
    ),
    "tension in g": Case(
        inputs(lambda u: u.__setitem__((slice(None), slice(6, 12)), u[:, 6:] * 101.97)), STEPS, "; valid: 0 … 7 N: in g?", "tension_"
    ),
    "negative": Case(
        inputs(lambda u: assign(u, (slice(20, 30), 8), -0.2)), STEPS, "lines 22 to 31: -0.2 N is negative; valid: 0 … 7", "tension_13_N"
    ),
    "force in g": Case(
        values(lambda run: {"tip_force": np.add(run.tip_force, [0, 0, -100.0])}),
        STEPS,
        "a tip force of 100 N is more than",
        "tip_force_z_N",
    ),
    # points
    "mm": Case(points(lambda p: p.__imul__(1e3)), STEPS, "in mm, not m?", "s1"),
    "one sensor in mm": Case(points(lambda p: p.__setitem__((slice(None), 2), 1e3 * p[:, 2])), STEPS, "in mm, not m?", "s3"),
    "sensor without samples": Case(
        points(lambda p: assign(p, (slice(None), 1), np.nan)), STEPS, "no sample in the whole run", "s2", severity="warning"
    ),
    "zeros for lost samples": Case(
        points(lambda p: assign(p, (slice(90, 95), 3), 0.0)), STEPS, "all coordinates are 0, a code for a lost", "s4"
    ),
    "mostly lost": Case(
        points(lambda p: assign(p, (slice(100, 280), 3), np.nan)),
        STEPS,
        "60 % of the samples are missing, the longest gap 180 rows",
        "s4",
        severity="warning",
    ),
    "interchanged": Case(points(lambda p: swapped(p, 1, 2)), STEPS, "s2 and s3 interchanged? Along the robot the points lie", "s2 s3"),
    "frozen": Case(points(lambda p: assign(p, (slice(120, 200), 1), p[120, 1])), STEPS, "lines 122 to 201: frozen", "s2"),
    "frozen for a moment": Case(
        points(lambda p: assign(p, (slice(120, 160), 1), p[120, 1])), STEPS, "lines 122 to 161: frozen", "s2", severity="warning"
    ),
    "one coordinate frozen": Case(
        points(lambda p: assign(p, (slice(120, 160), 1, 2), p[120, 1, 2])), STEPS, "lines 122 to 161: frozen", "s2_z_m"
    ),
    "spike": Case(points(lambda p: p[150, 2].__iadd__(0.08)), STEPS, "line 152: spikes of up to 8", "s3", severity="warning"),
    "spikes": Case(points(lambda p: p[10::9, 2].__iadd__(0.08)), STEPS, "2.7 % of the run's samples stray", "s3"),
    "shift": Case(points(lambda p: p[200:, 3].__iadd__(0.06)), STEPS, "line 202: jumps by up to 10", "s4"),
    "not at rest": Case(values(swing), STEPS, "not at rest at the start: moves at", "s"),
    "a stand that moves": Case(values(shake), STEPS, "all points move by as much: does its stand move?", "s", severity="warning"),
    "pasted": Case(points(lambda p: assign(p, slice(200, 240), p[100:140])), STEPS, "40 rows repeat the poses from line 102 on"),
    "the other run": Case(
        lambda f: (f / "other.csv").write_bytes((f / STEPS).read_bytes()), "other.csv", "the same positions as in steps.csv"
    ),
}
ALSO = {"mm": "in mm", "pasted": "jumps"}
"""Faults that rightly show as something else, too."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_dataset(make_dataset(), tmp_path / "set")
    return tmp_path / "set"


def test_every_file_is_read_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On the way to a verdict the data are checked and used as they were read."""
    opened: list[Path] = []
    plain = Path.open

    def counted(path: Path, *arguments: Any, **options: Any) -> Any:
        opened.append(path)
        return plain(path, *arguments, **options)

    monkeypatch.setattr(Path, "open", counted)
    dataset, _ = checked_dataset(folder)
    own = [path.name for path in opened if path.parent == folder]
    assert sorted(own) == sorted(["dataset.toml", *(run.file for run in dataset.runs)])


def test_nothing_is_wrong_at_first(folder: Path) -> None:
    assert check_reading(read_folder(folder, lambda robot: CHANNELS)) == []


def test_there_are_enough() -> None:
    assert len(CASES) >= 25


@pytest.mark.sample(3)
@pytest.mark.parametrize("name", CASES)
def test_one_clear_line(folder: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    case = CASES[name]
    case.spoil(folder)
    status = tepm(["data", "check", str(folder), "--json"])
    captured = capsys.readouterr()
    if case.unreadable:
        assert (status, captured.out, captured.err.count("\n")) == (2, "", 1)
        assert case.line in captured.err
        with pytest.raises(InputError):
            read_dataset(folder)
        return
    assert (status, captured.err) == (1 if case.severity == "error" else 0, "")
    errors = [finding for finding in check(folder) if finding.severity == case.severity]
    found = errors[0]
    assert case.line in found.message
    assert "\n" not in found.message
    assert (found.file, found.channel[: len(case.channel)]) == (case.file, case.channel)
    for other in errors[1:]:
        assert ALSO.get(name, "nothing else") in other.message, other
    if case.refused:
        with pytest.raises(InputError, match=f"{case.file}|{folder}") as error:
            read_dataset(folder, CHANNELS)
        assert "\n" not in str(error.value)
    else:
        read_dataset(folder, CHANNELS)

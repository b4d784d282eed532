"""Tables of other programs as a data set: read as a map file says, looked through, written."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.channels import Channels
from tepm_opt.data.checks.dataset import check_dataset
from tepm_opt.data.checks.findings import Finding, noise_level
from tepm_opt.data.datasets import DESCRIPTION, DataSet, in_session, write_dataset
from tepm_opt.data.documents import read_toml, toml_string
from tepm_opt.data.files import output_folder, write_atomically
from tepm_opt.data.importing.advice import try_entries, with_tried_entries
from tepm_opt.data.importing.clocks import time_map
from tepm_opt.data.importing.guess import guess_map, orientations, triples
from tepm_opt.data.importing.maps import ImportMap, Wanted, map_of, resolve_entries
from tepm_opt.data.importing.plausible import left_out, notes_of, refuse_implausible
from tepm_opt.data.importing.refusals import PUT, key, refusal, toml
from tepm_opt.data.importing.resample import GAP
from tepm_opt.data.importing.runs import ImportedRun, count_filter_steps, import_run, parts_of, rate_of, roles_of
from tepm_opt.data.importing.samples import samples_of
from tepm_opt.data.importing.sources import Sheet, read_sheet
from tepm_opt.data.run import run_of
from tepm_opt.data.tables import Table, write_columns
from tepm_opt.errors import InputError, unknown_name
from tepm_opt.jobs.check import Checked
from tepm_opt.models.channels import channels_of
from tepm_opt.models.robot import load_robot
from tepm_opt.progress import Progress, silent

LOG = "import.json"
UNKNOWN = 0.5  # s without samples in which inputs may have been anything


@dataclass(frozen=True, eq=False)
class ImportRun(Checked):
    """Runs read from other programs' files, not yet written.

    Attributes:
        given: the map.
        runs: on their grids.
        dataset: of a robot; None for any other machine.
        rate: of the rows in Hz; None in equilibria.
        notes: what a person should know, in words.
        findings: what `tepm data check` will say of a robot's data.
    """

    given: ImportMap
    runs: tuple[ImportedRun, ...]
    dataset: DataSet | None
    rate: float | None
    notes: tuple[str, ...]
    findings: tuple[Finding, ...]

    def __repr__(self) -> str:
        rate = "equilibria" if self.rate is None else f"{self.rate:g} Hz"
        return f"<ImportRun {self.outcome}; {len(self.runs)} runs, {rate}>"

    def rows(self) -> list[dict[str, Any]]:
        """A row of plain data for each entry of the map and run: columns, range in SI, rate, jitter, filter, lost samples."""
        found = []
        for run in self.runs:
            for place in dict.fromkeys(s.wanted.place for s in run.samples):
                own = [s for s in run.samples if s.wanted.place == place]
                clocks = [s.clock for s in own if s.clock is not None]
                values = [run.columns[s.target] for s in own if run.columns[s.target].dtype.kind == "f"]
                finite = np.array(values)[np.isfinite(values)] if values else np.empty(0)
                found.append(
                    {
                        "run": run.name,
                        "entry": place,
                        "columns": [s.column for s in own if s.column is not None],
                        "targets": [s.target for s in own],
                        "low": float(finite.min()) if finite.size else None,
                        "high": float(finite.max()) if finite.size else None,
                        "rate_hz": min((clock.rate for clock in clocks), default=None),
                        "jitter": max((clock.jitter for clock in clocks), default=0.0),
                        "longest_gap_s": max((float(clock.gaps.max()) for clock in clocks if clock.gaps.size), default=0.0),
                        "filtered": any(count_filter_steps(s, self.rate) > 1 for s in own),
                        "lost": 1 - finite.size / max(np.size(values), 1) if values else 0.0,
                    }
                )
        return found

    def summary(self) -> dict[str, Any]:
        """Runs, columns with rates and what was done to them, notes, number of findings."""
        runs = [
            {
                "file": run.file,
                "role": run.role,
                "rows": run.rows,
                "from": list(run.files),
                "start_s": run.start,
                "left_out_s": list(run.left_out),
            }
            for run in self.runs
        ]
        counts = {"errors": self.errors, "warnings": len(self.findings) - self.errors}
        return {"rate_hz": self.rate, "runs": runs, "entries": self.rows(), "notes": list(self.notes), **counts}

    def save(self, folder: str | Path) -> None:
        """Write the data set and `import.json`, each file whole or not at all, `dataset.toml` behind the runs.

        Raises:
            InputError: the folder holds a data set, or cannot be written to.
        """
        folder = Path(folder)
        refuse_taken(folder)
        folder = output_folder(folder)
        if self.dataset is not None:
            write_dataset(self.dataset, folder)
        else:
            for run in self.runs:
                write_columns(folder / run.file, run.columns)
            write_atomically(folder / DESCRIPTION, _description(self.given, self.runs, folder.name))
        write_atomically(folder / LOG, json.dumps(self.summary(), indent=2) + "\n")


def refuse_taken(folder: str | Path) -> None:
    """Refuse a folder that holds a data set.

    Raises:
        InputError: it does.
    """
    if (Path(folder) / DESCRIPTION).exists():
        raise InputError(f"{folder} holds a data set; name another folder")


def run_import(files: Sequence[str | Path], map_file: str | Path, name: str = "", progress: Progress = silent) -> ImportRun:
    """Read files of other programs as a map file says, all columns of a run on one grid. Nothing is written.

    Args:
        files: of one or several runs: text tables, Parquet, MAT, HDF5, ROS bags.
        map_file: which of their columns are which of the data set.
        name: of the data set where the map has none.
        progress: told of each file.

    Raises:
        InputError: names all columns concerned, and the entry that mends it.
    """
    content = read_toml(map_file)
    read = _Reader(files, map_file, name)
    try:
        return read(content, progress)
    except InputError as error:
        raise with_tried_entries(content, error, read) from error


class _Reader:
    """Reads files with one map after another, each file once for each way in which it may be written."""

    def __init__(self, files: Sequence[str | Path], map_file: str | Path, name: str = "") -> None:
        self._files, self._map_file, self._name = files, map_file, name
        self._sheets: dict[tuple[str, str], Sheet] = {}

    def _sheet(self, path: str | Path, given: ImportMap) -> Sheet:
        known = (str(path), given.csv.model_dump_json())
        if known not in self._sheets:
            self._sheets[known] = read_sheet(path, given.csv)
        return self._sheets[known]

    def __call__(self, content: Mapping[str, Any], progress: Progress = silent) -> ImportRun:
        given = map_of(content, self._map_file)
        sheets = []
        for number, path in enumerate(self._files):
            progress("reading files", number, len(self._files))
            sheets.append(self._sheet(path, given))
        progress("reading files", len(self._files), len(self._files))
        return _import(given, sheets, str(self._map_file), self._name or Path(self._map_file).stem)


def _import(given: ImportMap, sheets: Sequence[Sheet], where: str, name: str) -> ImportRun:
    """Runs of the columns of files."""
    robot = load_robot(given.robot) if given.robot is not None else None
    channels = channels_of(robot) if robot is not None else None
    asked = resolve_entries(given, channels, where)
    if channels is not None and not given.position:
        raise _no_position(given, sheets, channels)
    parts = parts_of(given, sheets, asked)
    roles = roles_of(given, [part.name for part in parts], where)
    samples = [samples_of(given, asked, part.sheets, part.rows) for part in parts]
    rate = None if given.static else min(rate_of(given, found, where) for found in samples)
    runs = [import_run(given, part, asked, roles[part.name], rate, found) for part, found in zip(parts, samples, strict=True)]
    dataset = None
    findings: list[Finding] = []
    if channels is None:
        _refuse_silent(given, runs, where)
    if channels is not None:
        for run in runs:
            refuse_implausible(run, given, asked, channels)
        dataset = _dataset(given, runs, channels, rate, name)
        findings = check_dataset(dataset)
    return ImportRun(given, tuple(runs), dataset, rate, tuple(_notes(given, asked, sheets, channels, runs)), tuple(findings))


def suggest_map(files: Sequence[str | Path], robot: str = "kang2017") -> str:
    """Text of a first map for files, by the names and sizes of their columns; for a person to look through.

    The map is tried: what still has to be answered or mended stands at its end.

    Raises:
        InputError: no such robot or file, or one that cannot be read.
    """
    text = guess_map([Path(path) for path in files], channels_of(load_robot(robot)), robot)
    content, read = tomllib.loads(text), _Reader(files, "map.toml")
    try:
        read(content)
    except InputError as error:
        _, end = try_entries(content, error, read)
        if end is not None:
            text += f"# still open: {str(end).partition(PUT)[0]}\n"
    return text


def _no_position(given: ImportMap, sheets: Sequence[Sheet], channels: Channels) -> InputError:
    found = [names for sheet in sheets[:1] for names in triples(sheet.order)][-len(channels.points) :]
    columns = [name for names in found for name in names]
    entry = {"columns": columns} | ({"of": list(channels.points[-len(found) :])} if len(found) < len(channels.points) else {})
    what = f"no position in the map: nothing measured; found: {', '.join(sheets[0].order)}"
    return refusal(sheets[0].path, what, f"position = {toml(entry)}" if found else "")


def _refuse_silent(given: ImportMap, runs: Sequence[ImportedRun], where: str) -> None:
    """Outputs of a machine of one's own need their noise; what their samples show is proposed. Points have one of three axes."""
    points = {name[:-2] for name in given.outputs if name.endswith(("_x", "_y", "_z"))}
    if unknown := [name for name in given.noise if name not in given.outputs and name not in points]:
        raise unknown_name("output", unknown[0], {*given.outputs, *points}, f"{where}: noise")
    silent = [name for name in given.outputs if name not in given.noise and name[:-2] not in given.noise]
    if silent:
        seen = {name: float(np.nanmax([noise_level(run.columns[name]) for run in runs])) for name in silent}
        entries = [f"noise.{key(name)} = {seen[name] if seen[name] > 0 else 1e-3:.1e}" for name in silent]
        raise refusal(where, f"no noise (1 sigma) of {', '.join(silent)}; the samples scatter so much", *entries)


def _dataset(given: ImportMap, runs: Sequence[ImportedRun], channels: Channels, rate: float | None, name: str) -> DataSet:
    made = []
    for run in runs:
        empty = {column: np.full(run.rows, np.nan) for column in channels.coordinates}
        nothing = {column: np.zeros(run.rows) for column in channels.inputs}
        columns = nothing | empty | dict(run.columns)
        _into_frame(columns, given, channels)
        table = Table(Path(run.file), columns, tuple(range(2, run.rows + 2)))
        made.append(run_of(table, run.file, run.role, channels, given.static))
    said = {}
    if all(b.start > a.start + (a.rows - 1) / (rate or 1) for a, b in pairwise(runs)):
        said = {run.file: run.start - runs[0].start for run in runs}
    assert given.robot is not None
    return DataSet(given.name or name, given.robot, channels, tuple(in_session(made, said)), rate, None, given.static)


def _into_frame(columns: dict[str, np.ndarray], given: ImportMap, channels: Channels) -> None:
    """Turn positions and the tip force from the tracker's axes into G's, and shift positions."""
    turn = [(("x", "y", "z").index(axis.removeprefix("-")), -1.0 if axis.startswith("-") else 1.0) for axis in given.frame.axes]
    triples = [[f"{name}_{axis}_m" for axis in "xyz"] for name in channels.points] + [[f"tip_force_{axis}_N" for axis in "xyz"]]
    for names in triples:
        if names[0] not in columns:
            continue
        offset = given.frame.offset_m if names[0].endswith("_m") else (0.0, 0.0, 0.0)
        turned = [
            sign * columns[names[k]] + shift if sign < 0 or shift else columns[names[k]]
            for (k, sign), shift in zip(turn, offset, strict=True)
        ]
        columns.update(zip(names, turned, strict=True))


def _notes(
    given: ImportMap, asked: Sequence[Wanted], sheets: Sequence[Sheet], channels: Channels | None, runs: Sequence[ImportedRun]
) -> list[str]:
    found = notes_of(given, asked, channels)
    if given.validation is None and len(runs) > 1:
        found.append(f"{runs[-1].file} is for validation, being the last; validation = [] in the map fits to all")
    for run in runs:
        if max(run.left_out) > 1e-9 + (1 / 1e3):
            before, behind = run.left_out
            found.append(
                f"{run.file}: {before:.3g} s at its start and {behind:.3g} s at its end left out: not all columns have samples there"
            )
        found += dict.fromkeys(word for s in run.samples if s.clock is not None for word in s.clock.told)
        found += _unknown(run)
        for file, dropped in {s.sheet.path.name: s.dropped for s in run.samples if s.sheet is not None and s.dropped}.items():
            found.append(f"{run.file}: {dropped} rows of {file} left out: no time, or that of another row")
    unused, turned = {}, []
    for sheet in sheets:
        found += [*sheet.told, *sheet.undecoded.values()]
        used = {sheet.name(column) for each in asked for column in each.columns} | {
            *map(sheet.name, time_map(given, sheet).names),
            *sheet.clocks.values(),
        }
        used |= {sheet.name(each.source.time) for each in asked if each.source.time is not None} | {sheet.name(given.split or "")}
        unused[sheet.path.name] = [name for name in sheet.order if name not in used]
        turned += orientations(sheet)
    return found + left_out(unused, turned)


def _unknown(run: ImportedRun) -> list[str]:
    """Words about inputs that changed while nobody recorded them."""
    found: dict[str, float] = {}
    for each in run.samples:
        if each.clock is None or not each.wanted.driven or each.wanted.source.between == "hold":
            continue
        steps, changed = np.diff(each.clock.time), np.diff(each.values) != 0
        if (long := (steps >= max(UNKNOWN, GAP * each.clock.step)) & changed).any():
            found[each.wanted.place] = max(found.get(each.wanted.place, 0.0), float(steps[long].max()))
    return [
        f"{run.file}: {place} changes within gaps of up to {gap:.2g} s, nobody knows how: straight lines there"
        for place, gap in found.items()
    ]


def _description(given: ImportMap, runs: Sequence[ImportedRun], folder: str) -> str:
    """`dataset.toml` of a machine of one's own."""
    lines = [f"name = {toml_string(given.name or folder)}"]
    lines += ["static = true"] if given.static else []
    lines += [f"start = {toml_string(given.start)}"] if given.start else []
    for run in runs:
        lines += ["", "[[runs]]", f"file = {toml_string(run.file)}", f"role = {toml_string(run.role)}"]
    lines += ["", "[noise]", *(f"{toml_string(name)} = {value!r}" for name, value in given.noise.items())]
    return "\n".join(lines) + "\n"

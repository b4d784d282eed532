"""Logs and data sets as MCAP files, which Foxglove, rerun and PlotJuggler open: JSON messages with their schemas inside."""

from __future__ import annotations

import importlib
import json
import re
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.channels import TIME
from tepm_opt.data.files import atomic_path, output_folder
from tepm_opt.data.run import run_columns
from tepm_opt.data.tables import read_table
from tepm_opt.errors import InputError
from tepm_opt.models.channels import open_dataset

TOPIC, POINTS = "/log", "/points"
FRAME = "G"
NANO = 1e9
_COORDINATE = re.compile(r"(s\d+)_([xyz])_m")
_NUMBER, _WHOLE = {"type": ["number", "null"]}, {"type": "integer"}
_VECTOR = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyz"}}
_QUATERNION = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyzw"}}
_POSE = {"type": "object", "properties": {"position": _VECTOR, "orientation": _QUATERNION}}
_TIMESTAMP = {"type": "object", "properties": {"sec": _WHOLE, "nsec": _WHOLE}}
_POSES = {
    "type": "object",
    "properties": {"timestamp": _TIMESTAMP, "frame_id": {"type": "string"}, "poses": {"type": "array", "items": _POSE}},
}
"""Foxglove's well-known message of poses, which 3-D views show."""


def export_mcap(source: str | Path, folder: str | Path) -> tuple[Path, ...]:
    """Write a log, or every run of a data set, as <name>.mcap; the files written.

    Topic /log has a message a row with all its columns, names and units as they are, null where nothing was measured; /points the
    reference points that were, for 3-D views. Times count from 0 at `time_s` = 0, or from the first row where that is before.

    Args:
        source: a CSV file with `time_s` (log.csv, trajectory.csv, a run, set points), or the folder of a data set.
        folder: that is filled, and made where it is not there.

    Raises:
        InputError: mcap is not installed, unreadable files, no `time_s`, or the folder cannot be written to.
    """
    writer, source = _writer(), Path(source)
    logs = _of_dataset(source) if source.is_dir() else _of_file(source)
    folder, written = output_folder(folder), []
    for name, columns in logs.items():
        written.append(folder / f"{name}.mcap")
        with atomic_path(written[-1]) as temporary:
            _write(writer, temporary, columns)
    return tuple(written)


def _writer() -> Any:
    """The writer's class.

    Raises:
        InputError: mcap is not installed.
    """
    try:
        return importlib.import_module("mcap.writer").Writer
    except ImportError as error:
        raise InputError("MCAP files need mcap, which is not installed: pip install 'tepm-opt[mcap]'") from error


def _of_dataset(folder: Path) -> dict[str, Mapping[str, np.ndarray]]:
    """Columns of every run of a data set, by its file's name without suffix.

    Raises:
        InputError: it is none, or static.
    """
    dataset = open_dataset(folder)
    if dataset.static:
        raise InputError(f"{folder}: static data have no time; valid: data with {TIME}")
    return {Path(run.file).stem: run_columns(run, dataset.channels) for run in dataset.runs}


def _of_file(path: Path) -> dict[str, Mapping[str, np.ndarray]]:
    """Columns of a file, of numbers or text, by its name without suffix.

    Raises:
        InputError: unreadable, or no `time_s` that increases.
    """
    table = read_table(path, text=lambda name: name != TIME)
    table.read_increasing(TIME)
    return {path.stem: table.columns}


def _write(writer_of: Any, path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """One file.

    Args:
        writer_of: the writer's class.
        path: of the file.
        columns: of the log.
    """
    kinds = {name: {"type": "string"} if values.dtype.kind == "U" else _NUMBER for name, values in columns.items()}
    places = _places(columns)
    with path.open("wb") as file:
        writer = writer_of(file)
        writer.start(profile="", library=f"tepm_opt {version('tepm-opt')}")
        log = _channel(writer, TOPIC, "tepm_opt.Log", {"type": "object", "properties": kinds})
        points = None if places is None else _channel(writer, POINTS, "foxglove.PosesInFrame", _POSES)
        early = min(float(columns[TIME][0]), 0.0)
        for row, now in enumerate(columns[TIME].tolist()):
            at = round((now - early) * NANO)
            message = {name: _value(values[row]) for name, values in columns.items()}
            writer.add_message(log, at, _json(message), at)
            if points is not None and places is not None:
                writer.add_message(points, at, _json(_poses(places, row, at)), at)
        writer.finish()


def _channel(writer: Any, topic: str, name: str, schema: dict[str, Any]) -> int:
    """Number of a new channel of JSON messages.

    Args:
        writer: of the file.
        topic: of the channel.
        name: of its schema.
        schema: of its messages.
    """
    number = writer.register_schema(name=name, encoding="jsonschema", data=_json(schema))
    return writer.register_channel(topic=topic, message_encoding="json", schema_id=number)


def _places(columns: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Reference points in m, (rows, points, 3); None where there are none."""
    found = sorted({match[1] for name in columns if (match := _COORDINATE.fullmatch(name))}, key=lambda name: int(name[1:]))
    whole = [name for name in found if all(f"{name}_{axis}_m" in columns for axis in "xyz")]
    if not whole:
        return None
    return np.stack([np.column_stack([columns[f"{name}_{axis}_m"] for axis in "xyz"]) for name in whole], axis=1)


def _poses(places: np.ndarray, row: int, at: int) -> dict[str, Any]:
    seconds, rest = divmod(at, int(NANO))
    poses = [
        {"position": dict(zip("xyz", place, strict=True)), "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
        for place in places[row].tolist()
        if all(value == value for value in place)
    ]
    return {"timestamp": {"sec": seconds, "nsec": rest}, "frame_id": FRAME, "poses": poses}


def _value(value: np.generic) -> str | float | None:
    """Convert a value to one that JSON has: infinite numbers and NaN are null."""
    plain = value.item()
    return plain if isinstance(plain, str) else float(plain) if np.isfinite(plain) else None


def _json(content: Any) -> bytes:
    return json.dumps(content, separators=(",", ":")).encode()

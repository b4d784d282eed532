"""Data sets of experiments (SPEC section 4): a folder with `dataset.toml` and one CSV file a run."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Annotated

import numpy as np
from pydantic import Field, ValidationError, model_validator

from tepm_opt.data.channels import Channels
from tepm_opt.data.documents import Section, explain, read_toml, refusal, require_range, toml_string, validate
from tepm_opt.data.files import output_folder, write_atomically
from tepm_opt.data.markup import html_table
from tepm_opt.data.run import Role, Run, RunSet, read_run_table, refuse_unusable, run_of, write_run
from tepm_opt.errors import InputError

DESCRIPTION = "dataset.toml"
APART = 5.0  # s between runs that do not say when they began
ChannelsOf = Callable[[str], Channels]
"""Channels of a robot given by built-in name or path."""


class RunEntry(Section):
    """A run in `dataset.toml`."""

    file: Annotated[str, Field(min_length=1, description="the name of a CSV file in the folder")]
    role: Role
    began_s: Annotated[float, require_range(0, 1e7, "s after the first run")] | None = None

    @model_validator(mode="after")
    def _check_file(self) -> RunEntry:
        if PurePosixPath(self.file).is_absolute() or ".." in PurePosixPath(self.file).parts or "\\" in self.file:
            raise ValueError(f"file = {self.file!r} is not in the folder of the data set; valid: the name of a CSV file in it")
        return self


class Description(Section):
    """The content of `dataset.toml`."""

    name: Annotated[str, Field(min_length=1, description="any text")]
    robot: Annotated[str, Field(min_length=1, description="a built-in robot or the path of a robot file")]
    sample_rate_hz: Annotated[float, require_range(1e-3, 1e6, "Hz")] | None = None
    position_noise_m: Annotated[float, require_range(0, 0.1, "m, 1 sigma per axis")] | None = None
    static: Annotated[bool, Field(strict=True, description="true where the rows are equilibria")] = False
    runs: list[RunEntry]

    @model_validator(mode="after")
    def _consistent(self) -> Description:
        if self.sample_rate_hz is None and not self.static:
            raise ValueError("missing key 'sample_rate_hz'; only data of equilibria (static = true) have none")
        files = [entry.file for entry in self.runs]
        if twice := sorted({name for name in files if files.count(name) > 1}):
            raise ValueError(f"runs: {twice[0]!r} is listed twice; a run belongs to one role")
        return self


@dataclass(frozen=True, eq=False)
class DataSet(RunSet):
    """Runs of one robot.

    Attributes:
        name: for people.
        robot: built-in robot or path of a robot file, as seen from the working folder.
        channels: names (and, where the robot was known when reading, magnitudes) of the columns.
        runs: in the order of `dataset.toml`.
        sample_rate: in Hz; None in data of equilibria.
        position_noise: 1 sigma per axis in m; None where unknown.
        static: whether rows are equilibria, not samples of a motion.
    """

    name: str
    robot: str
    channels: Channels
    runs: tuple[Run, ...]
    sample_rate: float | None = None
    position_noise: float | None = None
    static: bool = False

    def __post_init__(self) -> None:
        """Refuse runs that do not have the data set's columns.

        Raises:
            InputError: naming the run and both shapes.
        """
        for run in self.runs:
            if run.inputs.shape[1] != len(self.channels.inputs) or run.points.shape[1] != len(self.channels.points):
                found = f"{run.inputs.shape[1]} inputs and {run.points.shape[1]} points"
                raise InputError(f"{run.file}: {found}; valid: {len(self.channels.inputs)} and {len(self.channels.points)}")

    def __repr__(self) -> str:
        rate = "equilibria" if self.sample_rate is None else f"{self.sample_rate:g} Hz"
        return f"DataSet({self.name}: {len(self.fit)} runs to fit to, {len(self.validation)} to judge by, {rate}, robot {self.robot})"

    def _repr_html_(self) -> str:
        """The runs, for notebooks."""
        rows = [(run.file, run.role, str(run.rows), f"{run.duration:g}" if run.rows else "") for run in self.runs]
        return html_table(("run", "role", "rows", "duration in s"), rows, repr(self))


def read_description(folder: str | Path) -> Description:
    """`dataset.toml` alone.

    Raises:
        InputError: no such folder or file, no TOML, unknown or missing key, wrong value.
    """
    path = description_path(folder)
    return validate(Description, read_toml(path), str(path))


def description_path(folder: str | Path) -> Path:
    """The path of a data set's `dataset.toml`.

    Raises:
        InputError: there is none.
    """
    path = Path(folder) / DESCRIPTION
    if not path.parent.is_dir():
        raise InputError(f"data set {path.parent} is not a folder; valid: a folder with {DESCRIPTION}")
    if not path.is_file():
        raise InputError(f"data set {path.parent} has no {DESCRIPTION}")
    return path


@dataclass(frozen=True, eq=False)
class FolderReading:
    """Runs that could be read from a data set's folder, each file once, and faults of the others.

    Attributes:
        folder: that was read.
        listed: files of the runs in `dataset.toml`; none where that is wrong.
        dataset: the runs that could be read; None where `dataset.toml` is wrong.
        faults: what could not be read, as pairs of a file's name and what is wrong with it.
        refused: the first reason why nothing can be computed from the data; None where there is none.
    """

    folder: Path
    listed: tuple[str, ...]
    dataset: DataSet | None
    faults: tuple[tuple[str, str], ...]
    refused: InputError | None

    def __repr__(self) -> str:
        return f"FolderReading({self.folder}: {len(self.dataset.runs) if self.dataset else 0} runs, {len(self.faults)} faults)"

    @property
    def usable(self) -> DataSet:
        """The data set.

        Raises:
            InputError: the first reason why nothing can be computed from it.
        """
        if self.refused is not None or self.dataset is None:
            raise self.refused or InputError(f"{self.folder}: cannot be read")
        return self.dataset


def read_folder(folder: str | Path, channels_of: ChannelsOf | None = None) -> FolderReading:
    """Read all that can be read of a data set, and keep what is wrong with the rest.

    Args:
        folder: of `dataset.toml`.
        channels_of: the channels of the robot that `dataset.toml` names; where absent the header of the first readable run tells the names.

    Raises:
        InputError: no folder, no `dataset.toml`, or one that is not TOML.
    """
    folder = Path(folder)
    path = description_path(folder)
    content = read_toml(path)
    faults: list[tuple[str, str]] = []
    refused: list[InputError] = []

    def note_fault(file: str, error: InputError) -> None:
        faults.append((file, str(error).removeprefix(f"{folder / file}: ")))
        refused.append(error)

    try:
        description = Description.model_validate(content)
    except ValidationError as failure:
        wrong = tuple((DESCRIPTION, message) for message in explain(Description, failure))
        return FolderReading(folder, (), None, wrong, refusal(Description, failure, str(path)))
    channels = None
    if channels_of is not None:
        try:
            channels = channels_of(_robot_source(folder, description))
        except InputError as error:
            note_fault(DESCRIPTION, error)
    runs = []
    for entry in description.runs:
        try:
            table = read_run_table(folder / entry.file)
            channels = channels or Channels.from_header(table.columns)
            runs.append(run_of(table, entry.file, entry.role, channels, description.static))
        except InputError as error:
            note_fault(entry.file, error)
            continue
        try:
            refuse_unusable(table, channels, description.static)
        except InputError as error:  # the checks say more about it
            refused.append(error)
    try:
        runs = in_session(runs, {entry.file: entry.began_s for entry in description.runs}, f"{path}: ")
    except InputError as error:
        note_fault(DESCRIPTION, error)
    dataset = dataset_of(folder, description, channels or Channels((), ()), runs)
    listed = tuple(entry.file for entry in description.runs)
    return FolderReading(folder, listed, dataset, tuple(faults), next(iter(refused), None))


def in_session(runs: Sequence[Run], said: Mapping[str, float | None], where: str = "") -> list[Run]:
    """Runs with the time in the session at which each began: as said by file name, else 5 s after the run before.

    Raises:
        InputError: a run is said to begin before the one listed before it.
    """
    found: list[Run] = []
    before, after = -np.inf, 0.0
    for run in runs:
        told = said.get(run.file)
        if told is not None and not told > before:
            raise InputError(f"{where}runs: {run.file}: began_s = {told:g} s; valid: above {before:g} s, when the run before it began")
        began = after if told is None else told
        found.append(replace(run, began=began))
        before, after = began, began + APART + (run.duration if run.rows and np.isfinite(run.duration) else 0.0)
    return found


def read_dataset(folder: str | Path, channels: Channels | None = None) -> DataSet:
    """Read a data set as what follows can use it: finite inputs, increasing time. Doubtful values are found by `check_dataset`.

    Args:
        folder: of `dataset.toml`.
        channels: of the robot; where absent the header of the first run tells the names.

    Raises:
        InputError: as for `read_description` and `read_run`.
    """
    return read_folder(folder, None if channels is None else lambda robot: channels).usable


def dataset_of(folder: Path, description: Description, channels: Channels, runs: Iterable[Run]) -> DataSet:
    """A data set from the parts that were read; the robot's path becomes one from the working folder.

    Args:
        folder: where the data set is.
        description: content of its `dataset.toml`.
        channels: names and magnitudes of its columns.
        runs: its runs, in order.
    """
    rate, noise = description.sample_rate_hz, description.position_noise_m
    return DataSet(description.name, _robot_source(folder, description), channels, tuple(runs), rate, noise, description.static)


def _robot_source(folder: Path, description: Description) -> str:
    """Built-in name of the robot, or its file's path from the working folder."""
    robot = folder / description.robot
    return str(robot) if robot.is_file() else description.robot


def write_dataset(dataset: DataSet, folder: str | Path, overwrite: bool = False) -> None:
    """Write a data set: the runs, then `dataset.toml`, each file whole or not at all. A robot's path becomes relative to the folder.

    Raises:
        InputError: the folder holds a data set and `overwrite` is off; it cannot be written to.
    """
    folder = Path(folder)
    if (folder / DESCRIPTION).exists() and not overwrite:
        raise InputError(f"{folder} holds a data set; name another folder")
    folder = output_folder(folder)
    for run in dataset.runs:
        output_folder((folder / run.file).parent)
        write_run(folder / run.file, run, dataset.channels)
    write_description(folder, description_of(dataset, folder))


def description_of(dataset: DataSet, folder: Path) -> Description:
    """Description of a data set, as `dataset.toml` in this folder is to hold it.

    Raises:
        InputError: a value that the file may not hold.
    """
    robot = os.path.relpath(dataset.robot, folder) if Path(dataset.robot).is_file() else dataset.robot
    content = {
        "name": dataset.name,
        "robot": robot,
        "sample_rate_hz": dataset.sample_rate,
        "position_noise_m": dataset.position_noise,
        "static": dataset.static,
        "runs": [
            {"file": run.file, "role": run.role} | ({} if run.began in (0.0, usual.began) else {"began_s": run.began})
            for run, usual in zip(dataset.runs, in_session(dataset.runs, {}), strict=True)
        ],
    }
    return validate(Description, content, str(folder / DESCRIPTION))


def write_description(folder: str | Path, description: Description) -> None:
    """Write `dataset.toml`, whole or not at all.

    Raises:
        InputError: the folder cannot be written to.
    """
    lines = [f"name = {toml_string(description.name)}", f"robot = {toml_string(description.robot)}"]
    if description.sample_rate_hz is not None:
        lines.append(f"sample_rate_hz = {description.sample_rate_hz!r}")
    if description.position_noise_m is not None:
        lines.append(f"position_noise_m = {description.position_noise_m!r}")
    lines += ["static = true"] if description.static else []
    for entry in description.runs:
        lines += ["", "[[runs]]", f"file = {toml_string(entry.file)}", f"role = {toml_string(entry.role)}"]
        lines += [] if entry.began_s is None else [f"began_s = {entry.began_s!r}"]
    lines += [] if description.runs else ["runs = []"]
    write_atomically(Path(folder) / DESCRIPTION, "\n".join(lines) + "\n")

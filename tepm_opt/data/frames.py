"""Results and data sets as pandas data frames, data sets back. pandas is not a dependency: it is imported when asked for."""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.channels import Channels
from tepm_opt.data.datasets import DataSet
from tepm_opt.data.run import Role, Run, refuse_unusable, run_columns, run_of
from tepm_opt.data.tables import Table
from tepm_opt.errors import InputError

FILE, ROLE = "file", "role"


def _pandas() -> Any:
    try:
        return importlib.import_module("pandas")
    except ImportError as error:
        raise InputError("data frames need pandas, which is not installed: pip install pandas") from error


class Tabular(ABC):
    """A result that is a table, too: its columns, and these as a data frame."""

    @abstractmethod
    def columns(self) -> Mapping[str, np.ndarray]:
        """Columns by name, (rows,) each, of numbers or text; names end with the unit."""

    def to_frame(self) -> Any:
        """The columns as a pandas frame.

        Raises:
            InputError: pandas is not installed.
        """
        return _pandas().DataFrame(dict(self.columns()))


def run_to_frame(run: Run, channels: Channels) -> Any:
    """A run as a frame with the columns of its CSV file, a row a sample.

    Raises:
        InputError: pandas is not installed.
    """
    return _pandas().DataFrame(run_columns(run, channels))


def run_from_frame(frame: Any, file: str, role: Role = "fit", channels: Channels | None = None, static: bool = False) -> Run:
    """A run from a frame with the columns of SPEC section 4 and any others; `run_to_frame`'s inverse.

    Args:
        frame: a pandas frame, a row a sample.
        file: file name of the run.
        role: "fit" or "validation".
        channels: expected columns; those that the frame's names tell where absent.
        static: whether rows are equilibria, not samples of a motion.

    Raises:
        InputError: as for `read_run`; pandas is not installed.
    """
    _pandas()
    columns = {str(name): _values(frame[name], str(name), file) for name in frame.columns}
    table = Table(Path(file), columns, tuple(range(2, len(frame) + 2)))
    channels = channels or Channels.from_header(columns)
    run = run_of(table, file, role, channels, static)
    refuse_unusable(table, channels, static)
    return run


def _values(series: Any, name: str, file: str) -> np.ndarray:
    """A column as floats, or as text where it is not numeric; what is missing becomes NaN or empty."""
    extra = name not in Channels.from_header([name]).columns
    missing = series.isna().to_numpy()
    if series.dtype.kind in "biuf" or missing.all():
        return np.where(missing, np.nan, series.to_numpy(dtype=float, na_value=np.nan))
    if not extra:
        raise InputError(f"{file}: column {name!r} holds {series.dtype}; valid: numbers")
    return np.array(["" if empty else str(value) for value, empty in zip(series, missing, strict=True)], dtype=np.str_)


def dataset_to_frame(dataset: DataSet) -> Any:
    """All runs in one frame, in order, each row with the `file` and `role` of its run.

    Raises:
        InputError: pandas is not installed.
    """
    pandas = _pandas()
    frames = []
    for run in dataset.runs:
        frame = run_to_frame(run, dataset.channels)
        frame.insert(0, FILE, run.file)
        frame.insert(1, ROLE, run.role)
        frames.append(frame)
    return pandas.concat(frames, ignore_index=True) if frames else pandas.DataFrame({FILE: [], ROLE: []})


def dataset_from_frame(frame: Any, like: DataSet) -> DataSet:
    """A data set from a frame as `dataset_to_frame` makes it; name, robot, rate and channels are those of `like`.

    Columns that are empty throughout a run and are not SPEC's are not given to that run.

    Raises:
        InputError: no `file` or `role`; several roles in a run; as for `read_run`; pandas is not installed.
    """
    _pandas()
    if missing := [name for name in (FILE, ROLE) if name not in frame.columns]:
        raise InputError(f"data frame: column {missing[0]!r} is missing; every row names the file and role of its run")
    runs = []
    for file, part in frame.groupby(FILE, sort=False):
        roles = part[ROLE].unique().tolist()
        if len(roles) != 1:
            raise InputError(f"data frame: {file!r} has the roles {', '.join(map(str, roles))}; a run belongs to one role")
        own = part.drop(columns=[FILE, ROLE])
        own = own[[name for name in own.columns if str(name) in like.channels.columns or not own[name].isna().all()]]
        runs.append(run_from_frame(own, str(file), roles[0], like.channels, like.static))
    fields = (like.sample_rate, like.position_noise, like.static)
    return DataSet(like.name, like.robot, like.channels, tuple(runs), *fields)

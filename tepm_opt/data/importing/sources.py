"""Files of other programs as named columns: text tables, Parquet, MAT, HDF5, bags. What is optional says what to install."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.importing.bags import bag_columns
from tepm_opt.data.importing.maps import Format, Name
from tepm_opt.data.importing.text import text_columns
from tepm_opt.errors import InputError

INSTALL = 'pip install "tepm-opt[data]"'
TEXT = (".csv", ".tsv", ".txt", ".dat", ".log")
HDF5 = (".h5", ".hdf5", ".hdf", ".nxs")
BAGS = (".mcap", ".db3", ".bag")
SUFFIXES = (*TEXT, ".parquet", ".mat", *HDF5, *BAGS)


@dataclass(frozen=True, eq=False)
class Sheet:
    """Columns of a file.

    Attributes:
        path: of the file.
        columns: by name, (rows,) each: numbers, text or instants; lengths may differ between those of several clocks.
        lines: line of each row in the file; empty where it has no lines.
        order: names by number, from 1; names that stand twice are numbers only.
        twice: names that stand more than once in the header, with their numbers.
        clocks: columns of time in s that the file itself gives its columns.
        rate: in Hz, where the file states it.
        told: words about what was left out.
        groups: line above the header whose names would tell columns apart; 0: none.
        undecoded: words about topics of a bag whose messages cannot be decoded.
    """

    path: Path
    columns: Mapping[str, np.ndarray]
    lines: tuple[int, ...] = ()
    order: tuple[str, ...] = ()
    twice: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    clocks: Mapping[str, str] = field(default_factory=dict)
    rate: float | None = None
    told: tuple[str, ...] = ()
    groups: int = 0
    undecoded: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"Sheet({self.path}: {len(self.columns)} columns)"

    def name(self, column: Name) -> str | None:
        """The key of a column that a map names by name or number; None where there is none."""
        if isinstance(column, int):
            return self.order[column - 1] if 0 < column <= len(self.order) else None
        return column if column in self.columns and column not in self.twice else None

    def line(self, row: int) -> int:
        """Line of a row in the file; its number from 1 where the file has no lines."""
        return self.lines[row] if self.lines else row + 1


def optional(module: str, what: str) -> Any:
    """A module of the extra `data`.

    Raises:
        InputError: it is not installed; says what to install.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InputError(f"{what} needs {module.partition('.')[0]}, which is not installed: {INSTALL}") from error


def read_sheet(path: str | Path, form: Format) -> Sheet:
    """The columns of a file, by its suffix; a folder is a ROS 2 bag.

    Raises:
        InputError: no such file, not of its kind, nothing in it; a library of the extra `data` is not installed; says what mends it.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such file")
    suffix = path.suffix.lower()
    if suffix in BAGS or (path / "metadata.yaml").is_file():
        columns, clocks, undecoded = bag_columns(path, optional("rosbags.highlevel", f"{path}: a bag"))
        return Sheet(path, columns, order=tuple(columns), clocks=clocks, undecoded=undecoded)
    if path.is_dir():
        raise InputError(f"{path}: a folder; valid: files, or the folder of a ROS 2 bag (with metadata.yaml)")
    if suffix in TEXT:
        read = text_columns(path, form, optional("pandas", f"{path}: reading tables"))
        names = tuple(read.columns)
        return Sheet(path, read.columns, read.lines, names, read.twice, rate=read.rate, told=read.told, groups=read.groups)
    readers = {".parquet": _parquet, ".mat": _mat} | dict.fromkeys(HDF5, _hdf5)
    if suffix not in readers:
        raise InputError(f"{path}: unknown kind of file {suffix!r}; valid: {', '.join(SUFFIXES)}, or the folder of a ROS 2 bag")
    columns = dict(_flat(readers[suffix](path)))
    if not columns:
        raise InputError(f"{path}: holds no columns of numbers")
    return Sheet(path, columns, order=tuple(columns))


def _parquet(path: Path) -> dict[str, Any]:
    optional("pyarrow", f"{path}: a Parquet file")
    pandas = optional("pandas", f"{path}: reading tables")
    try:
        frame = pandas.read_parquet(path, engine="pyarrow")
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: is not a Parquet file: {_short(error)}") from error
    return {str(name): _array(frame[name]) for name in frame.columns}


def _array(series: Any) -> np.ndarray:
    """A column of a frame: numbers, instants, or texts."""
    if series.dtype.kind in "biuf":
        return series.to_numpy(dtype=float, na_value=np.nan) if series.isna().any() else series.to_numpy()
    if series.dtype.kind == "M":
        return series.dt.tz_localize(None).to_numpy(dtype="datetime64[ns]")
    return np.array(["" if missing else str(value) for value, missing in zip(series, series.isna(), strict=True)], dtype=object)


def _mat(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        found = loadmat(path, simplify_cells=True)
    except NotImplementedError:  # version 7.3
        return _hdf5(path, turned=True)
    except (MatReadError, ValueError, TypeError, OSError) as error:
        raise InputError(f"{path}: is not a MAT file: {_short(error)}") from error
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _hdf5(path: Path, turned: bool = False) -> dict[str, Any]:
    """Data sets of a file by their paths; MATLAB stores them `turned`."""
    h5py = optional("h5py", f"{path}: an HDF5 file")
    found: dict[str, Any] = {}

    def visit(name: str, each: Any) -> None:
        if isinstance(each, h5py.Dataset) and each.dtype.kind in "biufSOT" and not name.startswith("#"):
            values = each.asstr()[()] if h5py.check_string_dtype(each.dtype) is not None else each[()]
            if each.dtype.kind != "O" or h5py.check_string_dtype(each.dtype) is not None:
                found[name] = np.asarray(values).T if turned else np.asarray(values)

    try:
        with h5py.File(path) as file:
            file.visititems(visit)
    except OSError as error:
        raise InputError(f"{path}: is not an HDF5 file: {_short(error)}") from error
    return found


def _flat(found: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Columns of nested tables and of matrices: `tracker.pos` (rows, 3) is `tracker.pos_1` to `tracker.pos_3`."""
    for name, value in found.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{before}{name}.")
            continue
        values = np.asarray(value)
        if values.dtype.kind not in "biufMOUT" or values.size < 2 or values.ndim > 3:
            continue
        if values.ndim > 1 and values.size == max(values.shape):
            values = values.ravel()
        if values.ndim == 1:
            yield before + name, values
            continue
        if values.shape[0] < values.shape[-1] and values.ndim == 2:  # a column a row
            values = values.T
        values = values.reshape(len(values), -1)
        yield from ((f"{before}{name}_{k + 1}", values[:, k]) for k in range(values.shape[1]))


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:120]

"""The map file: which columns of a laboratory's tables are which of a data set's, in which units and on which clock."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Formatter
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from tepm_opt.data.channels import TIME, Channels
from tepm_opt.data.documents import Number, Section, Vector, read_toml, require_range, validate
from tepm_opt.data.importing.refusals import BETWEEN, PUT, key, refusal, toml
from tepm_opt.data.importing.units import factor, nearest
from tepm_opt.data.run import Start
from tepm_opt.data.setpoints import AXES, FORCE_COLUMNS
from tepm_opt.errors import InputError

NAMED = f'{PUT}robot = "kang2017"'
ISO = "iso"  # unit of date and time as text
Name = str | int
"""Name of a column: its header, or its number from 1."""
Columns = Annotated[
    str | int | list[str | int],
    Field(description='a pattern such as "p{module}{actuator}", "m{point}_{axis}" or "pos_{n}", or a list of names or numbers (from 1)'),
]


class TimeMap(Section):
    """Columns of a file's time, with their unit."""

    column: Annotated[Name | list[Name], Field(description="name or number of a column, or a list: hours, minutes, seconds")] | None = None
    unit: Annotated[str | list[str], Field(description='a unit of time, "iso" for date and time as text, or a list')] = "s"
    rate_hz: Annotated[float, require_range(1e-3, 1e6, "Hz")] | None = None
    rolls_over_at: Annotated[Number, Field(gt=0, description="value at which the counter begins again, in its unit")] | None = None
    date: Literal["day first", "month first"] | None = None
    file: Annotated[str, Field(description='pattern of the file\'s name: "*_tracker.csv"')] | None = None
    from_start: Annotated[bool, Field(strict=True, description="true: counts from the file's first row")] = False
    repeated: Literal["first", "last"] | None = None

    @model_validator(mode="after")
    def _check_together(self) -> TimeMap:
        if isinstance(self.column, list) != isinstance(self.unit, list) or len(self.names or "s") != len(self.units):
            raise ValueError('several columns need as many units; valid: unit = ["h", "min", "s", "ms"]')
        return self

    @property
    def names(self) -> list[Name]:
        """Columns of the time; none where rows have a rate only."""
        return self.column if isinstance(self.column, list) else [] if self.column is None else [self.column]

    @property
    def units(self) -> list[str]:
        """Units of the time's columns."""
        return self.unit if isinstance(self.unit, list) else [self.unit]


class Source(Section):
    """Origin of values, and their conversion to SI: unit · (scale · x + offset)."""

    unit: Annotated[str, Field(description="a unit, such as mm, bar or N")] = ""
    scale: Number = 1.0
    offset: Number = 0.0
    value: Annotated[Number, Field(description="a number, the same in all rows")] | None = None
    time: Annotated[Name, Field(description="name or number of the column with the time of these")] | None = None
    file: Annotated[str, Field(description='pattern of the file\'s name: "*_tracker.csv"')] | None = None
    between: Literal["line", "hold"] = "line"
    missing: Annotated[list[Number | str], Field(description="numbers or texts that stand for a lost sample")] = Field(default_factory=list)


class Quantity(Source):
    """Columns of one kind: all pressures, all positions."""

    columns: Columns | None = None
    of: Annotated[list[str], Field(description="names of actuators or points")] | None = None

    @model_validator(mode="after")
    def _either(self) -> Quantity:
        if (self.columns is None) == (self.value is None):
            raise ValueError("needs either columns or value")
        return self


class Single(Source):
    """One column."""

    column: Annotated[Name, Field(description="name or number of a column")] | None = None

    @model_validator(mode="after")
    def _either(self) -> Single:
        if (self.column is None) == (self.value is None):
            raise ValueError("needs either column or value")
        return self


class Format(Section):
    """Format of text files. Line numbers count from 1."""

    separator: Annotated[str, Field(min_length=1, max_length=1, description="one character")] | None = None
    decimal: Literal[".", ","] = "."
    header: Annotated[int, Field(ge=0, strict=True, description="line of the column names, 0 where there are none")] = 1
    first: Annotated[int, Field(ge=1, strict=True, description="line of the first row of numbers")] | None = None
    groups: Annotated[int | list[int], Field(description="lines above the header, whose names go before the columns'")] | None = None
    short_rows: Literal["ends", "all", "empty"] | None = None
    kinds: Annotated[bool, Field(strict=True, description="true: rows of several kinds, told apart by their first field")] = False
    encoding: Annotated[str, Field(description="such as utf-8, latin-1, utf-16")] = "utf-8"


class Frame(Section):
    """Axes of the tracker in G, and its offset."""

    axes: Annotated[list[str], Field(description="three of x, y, z, each with - or without: G's x, y, z are the tracker's …")] = Field(
        default_factory=lambda: list(AXES)
    )
    offset_m: Vector = (0.0, 0.0, 0.0)

    @field_validator("axes")
    @classmethod
    def _three(cls, axes: list[str]) -> list[str]:
        if sorted(axis.removeprefix("-") for axis in axes) != list(AXES):
            raise ValueError('valid: x, y and z, each once, with or without -: ["x", "-z", "y"]')
        return axes

    @property
    def rotation(self) -> np.ndarray:
        """Matrix that turns the tracker's coordinates into G's, (3, 3)."""
        found = np.zeros((3, 3))
        for row, axis in enumerate(self.axes):
            found[row, AXES.index(axis.removeprefix("-"))] = -1.0 if axis.startswith("-") else 1.0
        return found


class ImportMap(Section):
    """The content of a map file: of a robot's tables, or (without `robot`) of any machine's."""

    name: Annotated[str, Field(min_length=1, description="any text")] | None = None
    robot: Annotated[str, Field(min_length=1, description="a built-in robot or the path of a robot file")] | None = None
    rate_hz: Annotated[float, require_range(1e-3, 1e6, "Hz")] | None = None
    static: Annotated[bool, Field(strict=True, description="true where the rows are equilibria")] = False
    split: Annotated[Name, Field(description="a column; a new value begins a new run, or time that goes back")] | None = None
    validation: Annotated[list[str], Field(description='names of runs: ["run3", "circle*"]')] | None = None
    time: list[TimeMap] = Field(default_factory=list)
    csv: Format = Format()
    frame: Frame = Frame()
    pressure: Quantity | None = None
    tension: Quantity | None = None
    tip_force: Quantity | None = None
    position: Quantity | None = None
    pressure_measured: Quantity | None = None
    tension_measured: Quantity | None = None
    inputs: dict[str, Single] = Field(default_factory=dict)
    outputs: dict[str, Single] = Field(default_factory=dict)
    extra: dict[str, Single] = Field(default_factory=dict)
    noise: Annotated[dict[str, float], Field(description="1 sigma of each output, in its unit")] = Field(default_factory=dict)
    start: Start | None = None

    @field_validator("time", mode="before")
    @classmethod
    def _wrap_single_time(cls, time: Any) -> Any:
        return [time] if isinstance(time, dict) else time

    @model_validator(mode="after")
    def _kind(self) -> ImportMap:
        if any(name.startswith(("pressure_", "tension_")) and name.endswith(("_Pa", "_N")) for name in self.extra):
            raise ValueError("extra: pressures and tensions have entries of their own: pressure_measured, tension_measured")
        own = [name for name in ("inputs", "outputs", "noise", "start") if getattr(self, name)]
        robots = [name for name in QUANTITIES if getattr(self, name) is not None]
        if self.robot is None and robots:
            raise ValueError(f"{robots[0]} is a robot's, which the map does not name: built in, or the path of a robot file{NAMED}")
        if self.robot is None and self.frame != Frame():
            raise ValueError("frame is a robot's; valid: with robot, or without frame")
        if self.robot is not None and own:
            raise ValueError(f"{own[0]} belongs to a machine of your own; valid: either robot, or inputs, outputs and noise")
        if self.robot is None and not self.outputs:
            raise ValueError(f"nothing is measured: neither a robot (built in, or the path of a robot file) nor outputs{NAMED}")
        return self


QUANTITIES = {
    "pressure": "pressure",
    "tension": "force",
    "tip_force": "force",
    "position": "length",
    "pressure_measured": "pressure",
    "tension_measured": "force",
}
"""Dimension of each quantity of a robot."""


@dataclass(frozen=True)
class Wanted:
    """Columns of the data set that one entry of the map fills.

    Attributes:
        place: the entry: "pressure", "outputs.encoder".
        targets: columns of the data set.
        columns: where they come from, as many; none where the value is constant.
        source: the entry's other keys.
        driven: whether it is put in (taken on straight lines, never filtered), not measured.
        needed: whether no sample may be missing.
        dimension: of its unit; None where any will do.
    """

    place: str
    targets: tuple[str, ...]
    columns: tuple[Name, ...]
    source: Source
    driven: bool
    needed: bool
    dimension: str | None

    @property
    def si(self) -> float:
        """Size of its unit in SI."""
        return factor(self.source.unit, self.dimension)


def fits(pattern: str, name: str) -> tuple[str, ...] | None:
    """Match a file's name with a pattern: the text of each `*`; None where it does not fit."""
    found = re.fullmatch("(.*)".join(map(re.escape, pattern.split("*"))), name)
    return None if found is None else found.groups()


def time_with(given: ImportMap, entry: TimeMap, **changed: Any) -> str:
    """The line of TOML that changes an entry of time: its keys, or all entries where there are several."""
    if len(given.time) < 2:
        return BETWEEN.join(f"time.{name} = {toml(value)}" for name, value in changed.items())
    entries = [each.model_copy(update=changed) if each is entry else each for each in given.time]
    return f"time = {toml([each.model_dump(exclude_defaults=True) for each in entries])}"


def read_map(path: str | Path) -> ImportMap:
    """A map file; a robot's path becomes one from the working folder.

    Raises:
        InputError: no TOML, unknown key (lists the valid ones), wrong value.
    """
    return map_of(read_toml(path), path)


def map_of(content: Mapping[str, Any], path: str | Path) -> ImportMap:
    """The content of a map file, checked.

    Args:
        content: as TOML has it.
        path: of the map file, for errors and for a robot's path.

    Raises:
        InputError: unknown key (lists the valid ones), wrong value.
    """
    path = Path(path)
    found = validate(ImportMap, content, str(path))
    beside = path.parent / found.robot if found.robot else None
    return found.model_copy(update={"robot": str(beside)}) if beside is not None and beside.is_file() else found


def resolve_entries(given: ImportMap, channels: Channels | None, where: str) -> list[Wanted]:
    """Resolve a map's entries to the columns that they fill, checked: units, names of actuators and points, numbers of columns.

    Args:
        given: the map.
        channels: of its robot; None for a machine of one's own.
        where: the map's file, for errors.

    Raises:
        InputError: says which entry mends it.
    """
    found = [*_of_robot(given, channels, where)] if channels is not None else [*_of_machine(given)]
    found += [Wanted(f"extra.{key(name)}", (name,), _single(each), each, False, False, None) for name, each in given.extra.items()]
    for each in found:
        try:
            factor(each.source.unit, each.dimension)
        except InputError as error:
            raise refusal(
                where,
                f"{each.place}: {error}",
                f"{each.place}.unit = {toml(nearest(each.source.unit, each.dimension) if each.dimension else '')}",
            ) from error
    for time in given.time:
        for unit in (each for each in time.units if each != ISO or len(time.units) > 1):
            try:
                factor(unit, "time")
            except InputError as error:
                mended = [nearest(each, "time") if each == unit else each for each in time.units]
                entry = time_with(given, time, unit=mended if isinstance(time.unit, list) else mended[0])
                raise refusal(where, f"time: {error}, iso", entry) from error
    targets = [target for each in found for target in each.targets]
    if twice := sorted({target for target in targets if targets.count(target) > 1} | ({TIME} & set(targets))):
        raise InputError(f"{where}: {', '.join(twice)} filled twice; valid: once each, extra columns under other names")
    return found


def _single(each: Single) -> tuple[Name, ...]:
    return () if each.column is None else (each.column,)


def _of_machine(given: ImportMap) -> Iterator[Wanted]:
    for name, each in given.inputs.items():
        yield Wanted(f"inputs.{key(name)}", (name,), _single(each), each, True, True, None)
    for name, each in given.outputs.items():
        yield Wanted(f"outputs.{key(name)}", (name,), _single(each), each, False, False, None)


def _of_robot(given: ImportMap, channels: Channels, where: str) -> Iterator[Wanted]:
    for place, dimension in QUANTITIES.items():
        quantity: Quantity | None = getattr(given, place)
        if quantity is None:
            continue
        valid = {"position": channels.points, "tip_force": ("tip",)}.get(place, channels.actuators)
        names = _names(quantity, place, valid, where)
        targets, fields = _targets(place, names)
        columns = _columns(quantity, place, fields, valid, where)
        driven = place in ("pressure", "tension", "tip_force")
        yield Wanted(place, targets, columns, quantity, driven, driven, dimension)


def _names(quantity: Quantity, place: str, valid: Sequence[str], where: str) -> tuple[str, ...]:
    names = tuple(valid if quantity.of is None else quantity.of)
    if unknown := [name for name in names if name not in valid]:
        fitting = [name for name in names if name in valid] or list(valid)
        raise refusal(where, f"{place}.of: {', '.join(map(repr, unknown))}: valid: {', '.join(valid)}", f"{place}.of = {toml(fitting)}")
    return names


def _targets(place: str, names: Sequence[str]) -> tuple[tuple[str, ...], list[dict[str, Any]]]:
    """Columns of the data set, and what a pattern may say of each."""
    targets, fields = [], []
    for name in names:
        if place in ("position", "tip_force"):
            point = {"point": name[1:]} if place == "position" else {}
            targets += [f"{name}_{axis}_m" for axis in AXES] if place == "position" else list(FORCE_COLUMNS)
            fields += [{"name": name, **point, "axis": axis, "AXIS": axis.upper()} for axis in AXES]
        else:
            begin, _, measured = place.partition("_")
            module, actuator = name.split("_") if "_" in name else (name[:-1], name[-1])
            targets.append(f"{begin}_{name}_{'measured_' if measured else ''}{'Pa' if begin == 'pressure' else 'N'}")
            fields.append({"name": name, "module": module, "actuator": actuator})
    return tuple(targets), [{"n": k + 1, "n0": k, **each} for k, each in enumerate(fields)]


def _columns(quantity: Quantity, place: str, fields: list[dict[str, Any]], valid: Sequence[str], where: str) -> tuple[Name, ...]:
    given = quantity.columns
    if given is None:
        return ()
    if isinstance(given, str) and "{" in given:
        try:
            unknown = [name for _, name, _, _ in Formatter().parse(given) if name is not None and name not in fields[0]]
        except ValueError:
            unknown = [given]
        if unknown:
            shown = re.sub(r"\{[^}]*\}?", "{n}", given)
            known = ", ".join(f"{{{name}}}" for name in fields[0])
            raise refusal(
                where, f"{place}.columns = {given!r}: {unknown[0]!r} is no placeholder; valid: {known}", f"{place}.columns = {toml(shown)}"
            )
        return tuple(given.format(**each) for each in fields)
    columns = tuple(given) if isinstance(given, list) else (given,)
    if len(columns) == len(fields):
        return columns
    each = 3 if place == "position" else 1
    entry = (
        f"{place}.of = {toml(list(valid)[-(len(columns) // each) :])}"
        if len(columns) % each == 0 and len(columns) < each * len(valid)
        else ""
    )
    listed = ", ".join(repr(column) for column in columns)
    what = f"{place}.columns: {len(columns)} columns ({listed}) for {len(fields)} ({', '.join(dict.fromkeys(f['name'] for f in fields))}"
    raise refusal(where, f"{what}{', x, y and z each' if each == 3 else ''})", entry)

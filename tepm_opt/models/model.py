"""A model: a robot, what differs from its file, and effects. Plain frozen data that compares, prints, pickles and is stored."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from tepm_opt.data.documents import Section, read_text, read_toml, require_range, toml_string, validate
from tepm_opt.data.files import write_atomically
from tepm_opt.data.markup import html_table
from tepm_opt.errors import InputError, unknown_name
from tepm_opt.models.effect import ActiveEffect
from tepm_opt.models.effects import find_effect
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import UNITS, Parameters, Robot, builtin_robots, load_robot
from tepm_opt.renamed import RenamedMethod


@dataclass(frozen=True)
class Model:
    """A robot with changed parameters and additional effects.

    Attributes:
        robot: from the robot file.
        parameters: what differs from the robot file, by name, SI.
        effects: additional effects, in the order they act; those of devices act before the others.
        source: name or path by which a model file refers to the robot; models that differ only in it are equal.
        filter: settings of the predictive controller's filter by name (`FILTER_UNITS`), SI; see `tepm tune`.
    """

    robot: Robot
    parameters: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[ActiveEffect, ...] = ()
    source: str = field(default="kang2017", compare=False)
    filter: Mapping[str, float] = field(default_factory=dict)

    @staticmethod
    def from_robot(robot: str | Path | Robot) -> Model:
        """Make the nominal model of a robot given by built-in name, path or value."""
        if isinstance(robot, Robot):
            return Model(robot, source=robot.name)
        return Model(load_robot(robot), source=str(robot))

    of = RenamedMethod("from_robot")

    def __post_init__(self) -> None:
        check_parameters(self.robot, self.parameters, "model")
        layout = Layout.from_robot(self.robot)
        check_effects(self.effects, layout, "model")
        validate(_FilterTable, self.filter, "model: filter")
        object.__setattr__(self, "effects", tuple(_with_shapes(effect, layout) for effect in self.effects))

    def with_parameters(self, **values: float) -> Model:
        """This model with other values of robot parameters."""
        return replace(self, parameters={**self.parameters, **values})

    def with_effect(self, name: str, detail: str | None = None, **parameters: float) -> Model:
        """This model with one more effect; parameters not given have their probe values."""
        values = {parameter.name: parameter.probe for parameter in find_effect(name).parameters_of(Layout.from_robot(self.robot))}
        return replace(self, effects=(*self.effects, ActiveEffect(name, detail, {**values, **parameters})))

    def __repr__(self) -> str:
        changed = [f"{name}={value:g}" for name, value in self.parameters.items()]
        changed += [f"{effect.label}({', '.join(f'{n}={v:g}' for n, v in effect.parameters.items())})" for effect in self.effects]
        return f"Model({self.robot.name}: {', '.join(changed) or 'nominal'})"

    def _repr_html_(self) -> str:
        """Every parameter with its value and unit, and where it comes from, for notebooks."""
        return html_table(("parameter", "value", "unit", ""), self.table(), f"model of {self.robot.name}")

    def table(self) -> list[tuple[str, str, str, str]]:
        """Every parameter in words: its full name, value, unit, and where it comes from."""
        rows = []
        for name, nominal in self.robot.parameters.model_dump().items():
            value = self.parameters.get(name, nominal)
            rows.append((name, f"{value:g}", UNITS[name], f"instead of {nominal:g}" if name in self.parameters else "robot file"))
        for effect in self.effects:
            kind = find_effect(effect.name)
            own = kind.parameters_of(Layout.from_robot(self.robot))
            rows += [(f"{effect.label}.{p.name}", f"{effect.parameters[p.name]:g}", p.unit, kind.explains) for p in own]
        return rows

    @property
    def timed(self) -> bool:
        """Whether an effect asks what time it is."""
        return any(find_effect(effect.name).timed for effect in self.effects)

    @property
    def values(self) -> dict[str, float]:
        """Every parameter by full name ("K_a", "payload.mass", "actuator_gain[13].loss"), SI, robot's first."""
        values = {**self.robot.parameters.model_dump(), **self.parameters}
        for effect in self.effects:
            values |= {f"{effect.label}.{name}": value for name, value in sorted(effect.parameters.items())}
        return values


def check_parameters(robot: Robot, values: Mapping[str, float], where: str) -> None:
    """Refuse unknown robot parameters and values outside the robot file's ranges.

    Raises:
        InputError: with name, value and what is valid.
    """
    for name in values:
        if name not in UNITS:
            raise unknown_name("parameter", name, UNITS, where)
    validate(Parameters, {**robot.parameters.model_dump(), **values}, f"{where}: parameters")


def check_effect(effect: ActiveEffect, layout: Layout, where: str) -> None:
    """Refuse unknown effects, details and parameters, missing parameters and values out of range.

    Raises:
        InputError: with name, value and what is valid.
    """
    kind = find_effect(effect.name, where)
    details = layout.details(kind.detail)
    if kind.detail is None and effect.detail is not None:
        raise InputError(f"{where}: effect {effect.name!r} has no detail, found detail = {effect.detail!r}")
    if kind.detail is not None and effect.detail not in details:
        raise unknown_name(f"{kind.detail} in the detail of effect {effect.name!r}", str(effect.detail), details, where)
    known = {parameter.name: parameter for parameter in kind.parameters_of(layout)}
    for name, value in effect.parameters.items():
        if name not in known:
            raise unknown_name(f"parameter of effect {effect.name!r}", name, known, where)
        low, high, unit = known[name].low, known[name].high, known[name].unit
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not (number and math.isfinite(value) and low <= value <= high):
            raise InputError(f"{where}: effect {effect.name!r}: {name} = {value!r}; valid: {low:g} … {high:g} {unit}")
    needed = sorted(name for name, parameter in known.items() if not parameter.is_shape)
    if missing := [name for name in needed if name not in effect.parameters]:
        raise InputError(f"{where}: effect {effect.name!r}: parameter {missing[0]!r} is missing; it needs: {', '.join(needed)}")


def _with_shapes(effect: ActiveEffect, layout: Layout) -> ActiveEffect:
    """An effect with the usual values of the shape parameters that it does not give."""
    usual = {p.name: p.null for p in find_effect(effect.name).parameters_of(layout) if p.is_shape}
    return (
        effect
        if usual.keys() <= effect.parameters.keys()
        else replace(effect, parameters={**effect.parameters, **usual, **effect.parameters})
    )


def check_effects(effects: Sequence[ActiveEffect], layout: Layout, where: str) -> None:
    """Check all effects with `check_effect`, and that none is there twice.

    Raises:
        InputError: with name, value and what is valid.
    """
    for k, effect in enumerate(effects):
        check_effect(effect, layout, where)
        if effect.label in [other.label for other in effects[:k]]:
            raise InputError(f"{where}: effect {effect.label} stands twice; valid: once, with all its parameters")


class _FilterTable(Section):
    """Settings of the predictive controller's filter; `FilterSettings` says what each is."""

    friction_std: Annotated[float, require_range(0.0, 100.0, "N")] = 0.0
    friction_drift: Annotated[float, require_range(0.0, 100.0, "N/√s")] = 0.0
    strength_std: Annotated[float, require_range(0.0, 1.0, "")] = 0.0
    strength_drift: Annotated[float, require_range(0.0, 1.0, "1/√s")] = 0.0
    presliding_distance: Annotated[float, require_range(1e-5, 0.05, "m")] = 5e-4


FILTER_UNITS = {
    "friction_std": "N", "friction_drift": "N/√s", "strength_std": "of p A", "strength_drift": "1/√s", "presliding_distance": "m",
}  # fmt: skip
"""Units of the filter's settings that a model file may have."""


class _EffectTable(Section):
    """An effect in a model file."""

    name: str
    detail: str | None = None
    parameters: dict[str, Any] = Field(default_factory=dict)


class _ModelFile(Section):
    """The content of a model file."""

    robot: Annotated[str, Field(description="a built-in robot or the path of a robot file")]
    parameters: dict[str, Any] = Field(default_factory=dict)
    effects: list[_EffectTable] = Field(default_factory=list)
    filter: dict[str, Any] = Field(default_factory=dict)


WAY = "tepm reads model files in TOML, whose `robot` names a robot file: start one with `tepm robot new mine.toml`"


def read_model(path: str | Path) -> Model:
    """A model file (SPEC section 4); a robot path in it is relative to the file.

    Raises:
        InputError: unreadable file, unknown key, robot, parameter or effect, value out of range.
    """
    path = Path(path)
    where = str(path)
    table = validate(_ModelFile, read_toml(path, WAY), where)
    source = table.robot if table.robot in builtin_robots() else str(path.parent / table.robot)
    robot = load_robot(source, where)
    check_parameters(robot, table.parameters, where)
    effects = tuple(ActiveEffect(entry.name, entry.detail, entry.parameters) for entry in table.effects)
    check_effects(effects, Layout.from_robot(robot), where)
    validate(_FilterTable, table.filter, f"{where}: filter")
    parameters, levels = ({name: float(value) for name, value in part.items()} for part in (table.parameters, table.filter))
    return Model(robot, parameters, effects, source, levels)


def _store_robot_file(robot: Path, path: Path) -> str:
    """Name of a robot file beside a model file: its own where both are in one folder, else that of a copy made here, `model.robot.toml`."""
    if robot.resolve().parent == path.resolve().parent:
        return robot.name
    copy = path.with_suffix(".robot.toml")
    write_atomically(copy, read_text(robot))
    return copy.name


def write_model(model: Model, path: str | Path) -> None:
    """Write a model file that reads back equal, also where its folder is moved: a robot file from elsewhere is copied beside it.

    Raises:
        InputError: the model's robot is not what its `source` names, or the file cannot be written.
    """
    path = Path(path)
    if load_robot(model.source) != model.robot:
        raise InputError(f"{path}: the model's robot differs from {model.source!r}; save the robot as a file and set `source` to it")
    source = model.source if model.source in builtin_robots() else _store_robot_file(Path(model.source), path)
    lines = [f"robot = {toml_string(source)}"]
    if model.parameters:
        lines += ["", "[parameters]", *(f"{name} = {float(value)!r}  # {UNITS[name]}" for name, value in model.parameters.items())]
    for effect in model.effects:
        lines += ["", "[[effects]]", f"name = {toml_string(effect.name)}"]
        lines += [f"detail = {toml_string(effect.detail)}"] if effect.detail else []
        lines += [f"parameters = {{{', '.join(f'{name} = {float(value)!r}' for name, value in effect.parameters.items())}}}"]
    if model.filter:
        lines += ["", "[filter]", *(f"{name} = {float(value)!r}  # {FILTER_UNITS[name]}" for name, value in model.filter.items())]
    write_atomically(path, "\n".join(lines) + "\n")

"""The text of a rig file, with what every section is and what every value may be; what is off stands there as a comment."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, get_args

from pydantic.fields import FieldInfo

from tepm_opt.data.documents import Section, find_description, toml_string
from tepm_opt.hw.simulation.imperfections import Imperfections
from tepm_opt.hw.simulation.rigfile import RigFile

HEAD = (
    "A simulated rig: {use} simulates this machine; `tepm hw rig check` looks whether it can.",
    "`robot` is what a controller knows; everything else is what the machine has and the controller does not know.",
    'To the right is what is valid. Whatever stands behind a "#" is off, or as it is without: take the "#" away to use it.',
)
KEY = 44  # column of the remarks
FACTORS = "parameter_factors"
REMARKS = {
    "simulation": "How the machine is simulated; steps get shorter by themselves where the robot is stiff or light.",
    FACTORS: "The machine's parameters over those of the robot file: K_a = 1.02 is a muscle 2 % stiffer than the file says.",
}
FAULTS = (
    "Faults of tracker and gauges, to try what happens then; one [[faults]] for each, as many as you like. `of` is tracker (all points), a",
    "point (s4) or a gauge (pressure_13, tension_21); `kind` is one of",
    "  freeze   the last reading is repeated            repeat   every n-th reading repeats the one before: every",
    "  drop     readings are lost: probability          delay    readings are older than their time says: seconds",
    "  swap     two points or gauges are exchanged: with",
    "  invalid  poses are marked as not valid",
    "  [[faults]]",
    '  kind = "freeze"',
    '  of = "tracker"',
    "  from_s = 5.0                                # of the rig's time",
    "  until_s = 6.0                               # left out: until the end",
)


def rig_text(file: RigFile, robot: str, use: str = "--rig sim:FILE") -> str:
    """A rig as the text of a file that reads back equal.

    Args:
        file: the rig.
        robot: name or path of its robot, as seen from the file.
        use: how the file is used, for its head.
    """
    lines = [f"# {line.format(use=use)}" for line in HEAD]
    lines += ["", f"name = {toml_string(file.name)}", f"robot = {toml_string(robot)}", f"seed = {file.seed}"]
    for name in type(file).model_fields:
        section = getattr(file, name)
        if isinstance(section, Imperfections):
            items = [(f"{name}.{each}", getattr(section, each)) for each in type(section).model_fields]
            for title, item in (*(pair for pair in items if pair[1].active), *(pair for pair in items if not pair[1].active)):
                lines += ["", *_section(title, item, item.active)]
        elif name == FACTORS:
            lines += ["", *_write_title(name, REMARKS[name], True), *(f"{key} = {value!r}" for key, value in section.items())]
        elif isinstance(section, Section) and name != "robot":
            lines += ["", *_section(name, section, True)]
    lines += ["", *(f"# {line}" for line in FAULTS)]
    for fault in file.faults:
        lines += ["", "[[faults]]", *(f"{key} = {_value(value)}" for key, value in fault.entries().items())]
    return "\n".join(lines) + "\n"


def _write_title(title: str, remark: str, on: bool) -> list[str]:
    return [f"# {remark}", f"[{title}]" if on else f"# [{title}]"]


def _section(title: str, section: Section, on: bool) -> Iterator[str]:
    """A section with its keys; one that is off as a comment."""
    yield from _write_title(title, REMARKS.get(title) or (inspect.getdoc(type(section)) or "").splitlines()[0], on)
    for name, field in type(section).model_fields.items():
        value = getattr(section, name)
        yield f"{'' if on else '# '}{f'{name} = {_value(value)}':<{KEY}}# {_valid(field, value)}"


def _valid(field: FieldInfo, value: Any) -> str:
    """Describe the valid values of a key, for its remark."""
    choices = ("true", "false") if isinstance(value, bool) else get_args(field.annotation)
    valid = field.description or find_description(field.annotation) or " or ".join(map(str, choices))
    return f"by actuator or point, {valid}" if isinstance(value, Mapping) else valid


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return toml_string(value)
    if isinstance(value, Mapping):
        pairs = ", ".join(f"{toml_string(name)} = {_value(one)}" for name, one in value.items())
        return f"{{{pairs}}}"
    if isinstance(value, Sequence):
        return f"[{', '.join(map(_value, value))}]"
    return repr(value)

"""A rig of one robot, scaled to another: the virtual prototype of any robot.

What a robot's file knows of its devices (the tracker, lags and rates, the delay) is as much worse or better as it says. Everything else
keeps its part of what it disturbs: pressures of the largest pressure, tensions of the largest tension, lengths of a module's length, masses
of a module's mass, stiffnesses of the muscles'; shares and factors stay. Values by actuator are dealt out anew, in order.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tepm_opt.data.documents import Section
from tepm_opt.hw.simulation.imperfections import Imperfections, TimeDelay
from tepm_opt.hw.simulation.imperfections.base import Imperfection
from tepm_opt.hw.simulation.imperfections.body import RigidPlates
from tepm_opt.hw.simulation.imperfections.edges import StructuralFriction
from tepm_opt.hw.simulation.imperfections.pressure import RegulatorLag
from tepm_opt.hw.simulation.rigfile import RigFile
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot

MOST_CLAMPED = 0.3  # of a segment's height: more of it would leave nothing that is elastic
DIGITS = 6  # of scaled values, which people read
Ratios = Mapping[str, float]
"""Another robot's magnitudes over the rig's, by the end of a key's name."""


def scale_rig(file: RigFile, robot: Robot) -> RigFile:
    """Replace a rig's robot by another one and scale everything to it; the same rig where the robot is its own.

    Args:
        file: of a rig of any robot.
        robot: to be simulated.
    """
    own = file.nominal
    if robot == own:
        return file
    ratios = _ratios(own, robot)
    told, meant = own.tracker, robot.tracker
    return file.model_copy(
        update={
            "name": f"{file.name} of {robot.name}",
            "robot": robot,
            "stepper": _times(
                file.stepper, rate_limit_N_per_s=_divide_or_one(robot.actuation.tension_rate_N_per_s, own.actuation.tension_rate_N_per_s)
            ),
            "pressure_monitor": _scale_section(file.pressure_monitor, ratios),
            "dynamometer": _scale_section(file.dynamometer, ratios),
            "tracker": _times(
                file.tracker,
                rate_hz=_divide_or_one(meant.rate_Hz, told.rate_Hz),
                latency_s=_divide_or_one(meant.latency_s, told.latency_s),
                noise_rms_m=_divide_or_one(meant.noise_rms_m, told.noise_rms_m),
            ),
            "imperfections": _imperfections(file.imperfections, own, robot, ratios),
        }
    )


def _imperfections(imperfections: Imperfections, own: Robot, robot: Robot, ratios: Ratios) -> Imperfections:
    """Those that do something, scaled and dealt out anew."""
    names = Layout.from_robot(own).actuator_names, Layout.from_robot(robot).actuator_names
    changed: list[Imperfection] = []
    for item in imperfections.active.values():
        mine = ratios
        if isinstance(item, StructuralFriction):  # bristles sit in edges, which are the stiffer the more of them make a muscle
            finer = robot.geometry.segments_per_module / own.geometry.segments_per_module
            mine = {**ratios, "_N_per_m": finer * ratios["_N_per_m"], "_N_s_per_m": finer * ratios["_N_s_per_m"]}
        found = _dealt(_scale_section(item, mine), *names)
        if isinstance(item, TimeDelay):
            found = _times(item, delay_s=_divide_or_one(robot.actuation.command_delay_s, own.actuation.command_delay_s))
        if isinstance(item, RegulatorLag):
            lags = (
                _divide_or_one(getattr(robot.actuation, name), getattr(own.actuation, name))
                for name in ("filling_time_s", "exhausting_time_s")
            )
            found = _times(item, **dict(zip(("fill_s", "exhaust_s"), lags, strict=True)))
        if isinstance(found, RigidPlates):
            most = MOST_CLAMPED * robot.parameters.L_0 / robot.geometry.segments_per_module
            found = found.model_copy(update={"clamped_length_m": min(found.clamped_length_m, most)})
        changed.append(found)
    return imperfections.replace_kinds(*changed)


def _ratios(own: Robot, robot: Robot) -> dict[str, float]:
    """Magnitudes of another robot over those of the rig's; 1 where there are none, such as the stiffness of a muscle beside a spring."""
    was, now = own.parameters, robot.parameters
    found = {
        "_Pa": _divide_or_one(robot.actuation.pressure_max_Pa, own.actuation.pressure_max_Pa),
        "_N": _divide_or_one(robot.actuation.tension_max_N, own.actuation.tension_max_N),
        "_m": _divide_or_one(now.L_0, was.L_0),
        "_kg": _divide_or_one(now.m_d, was.m_d),
        "_N_per_m": _divide_or_one(now.K_a, was.K_a),
        "_N_s_per_m": _divide_or_one(now.c_a, was.c_a),
    }
    return {end: ratio or 1.0 for end, ratio in found.items()}


def _divide_or_one(value: float, own: float) -> float:
    """Divide two magnitudes; 1 where there is none to compare with."""
    return value / own if own else 1.0


def _scale_section(section: Any, ratios: Ratios) -> Any:
    """Scale the numbers of a section by the ratio of their unit, which the end of their name tells."""
    ends = sorted(ratios, key=len, reverse=True)
    rules = {name: next((ratios[end] for end in ends if name.endswith(end)), 1.0) for name in type(section).model_fields}
    return _times(section, **rules)


def _times(section: Section, **factors: float) -> Any:
    """A section with some numbers, or tables and rows of numbers, multiplied."""

    def product(value: Any, factor: float) -> Any:
        if isinstance(value, Mapping):
            return {name: product(each, factor) for name, each in value.items()}
        if isinstance(value, tuple):
            return tuple(product(each, factor) for each in value)
        return float(f"{factor * value:.{DIGITS}g}") if isinstance(value, float) and factor != 1.0 else value

    return section.model_copy(update={name: product(getattr(section, name), factor) for name, factor in factors.items()})


def _dealt(item: Imperfection, own: tuple[str, ...], names: tuple[str, ...]) -> Any:
    """An imperfection whose values by actuator go round the other robot's actuators, in their order."""
    changed = {}
    for key in type(item).model_fields:
        values = getattr(item, key)
        if isinstance(values, Mapping) and values and set(values) <= set(own):
            row = [values.get(name, 0.0) for name in own]
            changed[key] = {name: row[k % len(row)] for k, name in enumerate(names)}
    return item.model_copy(update=changed) if changed else item

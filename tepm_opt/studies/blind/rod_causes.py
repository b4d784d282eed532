"""Causes in a robot whose body is a Cosserat rod, by the means of PyElastica and of the rod's design.

docs/results/blind.md lists them with their names. Dry friction is not among them: PyElastica has it only where a rod lies on a plane.
"""

from __future__ import annotations

import numpy as np

from tepm_opt.hw.simulation.imperfections.base import Body
from tepm_opt.studies.blind.causes import MUSCLES, Cause, direction
from tepm_opt.studies.blind.engine_forms import (
    ActuatorChange,
    Change,
    change_actuator,
    change_model,
    drift_tracker,
    pull_tip,
    tilt_gravity,
    turn_tracker,
)
from tepm_opt.studies.blind.excitation import COUNT
from tepm_opt.studies.blind.rod_design import RodDesign

LONG = 3  # elements of a part that is softer


def _set_design(name: str) -> Change:
    """Set a number of the design to the size."""
    return lambda design, body, size: setattr(design, name, size)


def _scale_gain(first: int) -> ActuatorChange:
    """Weaken an input of a muscle: pressures begin at 0, tensions at `COUNT`."""

    def change(design: RodDesign, body: Body, which: str, loss: float) -> None:
        design.gains[first + MUSCLES.index(which)] *= 1 - loss

    return change


def _add_offset(design: RodDesign, body: Body, which: str, pressure: float) -> None:
    design.offset[MUSCLES.index(which)] += pressure


def _set_gravity(design: RodDesign, body: Body, gravity: np.ndarray) -> None:
    body.gravity = gravity


def _add_wall(random: np.random.Generator) -> Change:
    toward = np.append(direction(random, 2), 0.0)

    def change(design: RodDesign, body: Body, size: float) -> None:
        design.wall = body.robot.parameters.r + 0.08 - size, toward

    return change


def _soften_part(random: np.random.Generator) -> Change:
    drawn = float(random.uniform())

    def change(design: RodDesign, body: Body, size: float) -> None:
        first = 1 + int(drawn * (len(design.share) - LONG))
        design.share[first : first + LONG] *= 1 - size

    return change


def _bend_body(random: np.random.Generator) -> Change:
    about = np.append(direction(random, 2), 0.0)

    def change(design: RodDesign, body: Body, size: float) -> None:
        design.curvature += size * about

    return change


KNOWN: dict[str, Cause] = {
    "heavy_tip": change_model("payload", (5e-3, 1e-4, 0.1), lambda random: _set_design("tip_mass"), mass=1.0),
    "leaning_base": tilt_gravity(_set_gravity),
    "pulled_tip": pull_tip,
    "filtered_bladders": change_model(
        "regulator_lag", (0.06, 1e-3, 0.5), lambda random: _set_design("filling"), filling_time=1.0, exhausting_time=1.0
    ),
    "delayed_actuators": change_model("time_delay", (0.03, 1e-3, 0.3), lambda random: _set_design("delay"), delay=1.0),
    "weak_bladder": change_actuator("actuator_gain", (0.05, 1e-3, 0.5), "loss", _scale_gain(0)),
    "weak_motor": change_actuator("tension_gain", (0.1, 1e-3, 0.8), "loss", _scale_gain(COUNT)),
    "prestressed_bladder": change_actuator("actuator_offset", (4e3, 50.0, 5e4), "pressure", _add_offset),
    "cubic_muscles": change_model("stiffness_hardening", (100.0, 1.0, 5e3), lambda random: _set_design("cubic"), cubic=1.0),
    "turned_tracker": turn_tracker,
    "drifting_tracker": drift_tracker,
}
"""By key; each form has the name of an effect of the library."""
UNKNOWN: dict[str, Cause] = {
    "touched_wall": change_model(None, (0.05, 0.03, 0.08), _add_wall),
    "viscous_bath": change_model(None, (0.05, 1e-3, 2.0), lambda random: _set_design("viscosity")),
    "soft_part": change_model(None, (0.1, 1e-3, 0.6), _soften_part),
    "bent_body": change_model(None, (0.02, 1e-4, 1.0), _bend_body),
}
"""By key; no name is right for any of them."""

"""Causes in a robot that MuJoCo moves, by MuJoCo's own means.

docs/results/blind.md lists them with their names.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

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
from tepm_opt.studies.blind.mujoco_world import load_mujoco

DRY = {"solref_friction": [0.004, 1.0], "solimp_friction": [0.99, 0.999, 1e-3, 0.5, 2.0]}
"""Friction that hardly creeps: the constraint's default lets a muscle slide at 1 cm/s before it holds with 0.1 N."""
REEL_MASS, REEL_DAMPING, CABLE = 0.02, 0.3, 2000.0  # kg, N s/m and N/m: faster and stiffer than the muscles, and hardly damped
GUIDE = 1.0  # m above the reels, whose springs only pull


def _scale_gain(kind: str) -> ActuatorChange:
    """Weaken an actuator that pushes by "pressure" or pulls by "tension"."""

    def change(spec: Any, body: Body, which: str, loss: float) -> None:
        actuator = spec.actuator(f"{kind}_{which}")
        values = np.array(actuator.gainprm)
        values[0] *= 1 - loss
        actuator.gainprm = values

    return change


def _add_bias(spec: Any, body: Body, which: str, pressure: float) -> None:
    actuator = spec.actuator(f"pressure_{which}")
    values = np.array(actuator.biasprm)
    values[0] += pressure * body.robot.parameters.A
    actuator.biasprm = values


def _load_tip(random: np.random.Generator) -> Change:
    shares = 1 / 3 + (beside := random.uniform(-0.08, 0.08, 3)) - beside.mean()

    def change(spec: Any, body: Body, size: float) -> None:
        for node, share in enumerate(shares):
            spec.body(f"b{body.layout.levels}_{node}").mass += size * share

    return change


def _set_gravity(spec: Any, body: Body, gravity: np.ndarray) -> None:
    spec.option.gravity = gravity


def _muscle_edges(spec: Any, body: Body) -> list[Any]:
    return [spec.tendon(f"e{level}_{node}") for level in range(1, body.layout.levels + 1) for node in range(body.layout.actuators)]


def _roughen_muscles(random: np.random.Generator) -> Change:
    def change(spec: Any, body: Body, size: float) -> None:
        for edge in _muscle_edges(spec, body):
            edge.frictionloss, edge.solref_friction, edge.solimp_friction = size, *DRY.values()

    return change


def _filter_pressures(random: np.random.Generator) -> Change:
    def change(spec: Any, body: Body, size: float) -> None:
        mujoco = load_mujoco()
        for name in MUSCLES:
            actuator = spec.actuator(f"pressure_{name}")
            actuator.dyntype, actuator.dynprm = mujoco.mjtDyn.mjDYN_FILTEREXACT, [size] + [0.0] * 9

    return change


def _delay_actuators(random: np.random.Generator) -> Change:
    def change(spec: Any, body: Body, size: float) -> None:
        for actuator in spec.actuators:
            actuator.delay, actuator.nsample = size, int(np.ceil(size / spec.option.timestep)) + 2

    return change


def _harden_muscles(random: np.random.Generator) -> Change:
    def change(spec: Any, body: Body, size: float) -> None:
        for edge in _muscle_edges(spec, body):
            stiffness = np.array(edge.stiffness)
            stiffness[2] += size / edge.springlength[0] ** 3  # of the force by x³, x the elongation
            edge.stiffness = stiffness

    return change


def _add_reels(random: np.random.Generator) -> Change:
    """A motor pulls a reel that a spring holds back; a muscle's cable is too long by the slack, so that the reel has to go first."""
    spring = random.uniform(6.0, 20.0)  # N/m

    def change(spec: Any, body: Body, size: float) -> None:
        mujoco = load_mujoco()
        layout, value = body.layout, body.robot.parameters
        for k, name in enumerate(MUSCLES):
            module, node = divmod(k, layout.actuators)
            reel = spec.worldbody.add_body(name=f"reel_{name}", mass=REEL_MASS, inertia=[1e-6] * 3, explicitinertial=True, gravcomp=1.0)
            slide = reel.add_joint(name=f"reel_{name}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, -1])
            slide.damping = [REEL_DAMPING, 0.0, 0.0]
            reel.add_site(name=f"reel_{name}")
            spec.worldbody.add_site(name=f"guide_{name}", pos=[0.0, 0.0, GUIDE])
            holder = spec.add_tendon(name=f"holder_{name}", stiffness=[spring, 0.0, 0.0], springlength=[0.0, GUIDE])
            cable = spec.add_tendon(name=f"cable_{name}", stiffness=[CABLE, 0.0, 0.0], springlength=[0.0, GUIDE + value.L_0 + size])
            for tendon in (holder, cable):
                tendon.wrap_site(f"reel_{name}")
                tendon.wrap_site(f"guide_{name}")
            cable.wrap_pulley(1.0)  # what the cable runs through besides
            for level in range(layout.segments + 1):
                cable.wrap_site(f"n{module * layout.segments + level}_{node}")
            motor = spec.actuator(f"tension_{name}")
            motor.trntype, motor.target = mujoco.mjtTrn.mjTRN_JOINT, f"reel_{name}"
            motor.gainprm = [1.0] + [0.0] * 9

    return change


def _add_wall(random: np.random.Generator) -> Change:
    toward = np.append(direction(random, 2), 0.0)

    def change(spec: Any, body: Body, size: float) -> None:
        mujoco = load_mujoco()
        place = (body.robot.parameters.r + 0.08 - size) * toward
        turn = Rotation.align_vectors([-toward], [[0.0, 0.0, 1.0]])[0].as_quat()
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0], pos=place, quat=[turn[3], *turn[:3]], friction=[0.3, 0.0, 0.0]
        )
        for node in range(body.layout.actuators):
            tip = spec.body(f"b{body.layout.levels}_{node}")
            tip.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1e-3, 0.0, 0.0], mass=0.0, friction=[0.3, 0.0, 0.0])

    return change


def _stop_muscle(random: np.random.Generator) -> Change:
    which = str(random.choice(MUSCLES))

    def change(spec: Any, body: Body, size: float) -> None:
        muscle = spec.tendon(f"muscle_{which}")
        muscle.limited, muscle.range = True, [0.0, body.robot.parameters.L_0 + 0.06 - size]

    return change


def _rub_level(random: np.random.Generator) -> Change:
    level = int(random.integers(4, 13))

    def change(spec: Any, body: Body, size: float) -> None:
        for node in range(body.layout.actuators):
            for slide in spec.body(f"b{level}_{node}").joints:
                slide.frictionloss, slide.solref_friction, slide.solimp_friction = size, *DRY.values()

    return change


def _fill_bath(random: np.random.Generator) -> Change:
    def change(spec: Any, body: Body, size: float) -> None:
        spec.option.viscosity = size

    return change


KNOWN: dict[str, Cause] = {
    "heavy_tip": change_model("payload", (5e-3, 1e-4, 0.1), _load_tip, mass=1.0),
    "leaning_base": tilt_gravity(_set_gravity),
    "pulled_tip": pull_tip,
    "dry_muscles": change_model("structural_friction", (0.1, 1e-3, 1.5), _roughen_muscles),
    "filtered_bladders": change_model("regulator_lag", (0.06, 1e-3, 0.5), _filter_pressures, filling_time=1.0, exhausting_time=1.0),
    "delayed_actuators": change_model("time_delay", (0.03, 1e-3, 0.3), _delay_actuators, delay=1.0),
    "weak_bladder": change_actuator("actuator_gain", (0.05, 1e-3, 0.5), "loss", _scale_gain("pressure")),
    "weak_motor": change_actuator("tension_gain", (0.1, 1e-3, 0.8), "loss", _scale_gain("tension")),
    "prestressed_bladder": change_actuator("actuator_offset", (4e3, 50.0, 5e4), "pressure", _add_bias),
    "cubic_muscles": change_model("stiffness_hardening", (100.0, 1.0, 5e3), _harden_muscles, cubic=1.0),
    "reeled_tendons": change_model("tendon_slack", (0.03, 1e-3, 0.2), _add_reels, ("tendon_friction",)),
    "turned_tracker": turn_tracker,
    "drifting_tracker": drift_tracker,
}
"""By key; each form has the name of an effect of the library."""
UNKNOWN: dict[str, Cause] = {
    "touched_wall": change_model(None, (0.05, 0.03, 0.08), _add_wall),
    "stopped_muscle": change_model(None, (0.042, 0.03, 0.059), _stop_muscle),
    "rubbing_level": change_model(None, (0.02, 1e-4, 1.0), _rub_level),
    "viscous_bath": change_model(None, (0.1, 1e-3, 5.0), _fill_bath),
}
"""By key; no name is right for any of them."""
OTHER_MEANING_IN_MUJOCO = {
    "dry_muscles": ("c_a",),
    "reeled_tendons": ("c_a",),
}
"""Parameters of the robot that mean something else beside a cause: constraints are partly viscous, cables and reels have dampers."""

"""Causes in a robot that MuJoCo moves, by MuJoCo's own means.

docs/results/blind.md lists them with their names.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tepm_opt.hw.simulation.imperfections.base import Body
from tepm_opt.studies.blind.causes import MUSCLES, Cause, Form, direction, no_sizes
from tepm_opt.studies.blind.machine import Deviation
from tepm_opt.studies.blind.mujoco_world import load_mujoco

Change = Callable[[Any, Body, float], None]
"""Changes MuJoCo's document (`mujoco.MjSpec`) of a network, by a size."""
DRY = {"solref_friction": [0.004, 1.0], "solimp_friction": [0.99, 0.999, 1e-3, 0.5, 2.0]}
"""Friction that hardly creeps: the constraint's default lets a muscle slide at 1 cm/s before it holds with 0.1 N."""
REEL_MASS, REEL_DAMPING, CABLE = 0.02, 0.3, 2000.0  # kg, N s/m and N/m: faster and stiffer than the muscles, and hardly damped
GUIDE = 1.0  # m above the reels, whose springs only pull


def _deviate(change: Change, size: float) -> Deviation:
    return Deviation(build=lambda spec, body: change(spec, body, size))


Limits = tuple[float, float, float]
"""Usual, smallest and largest size, see `Form`."""


def _change_model(
    name: str | None, limits: Limits, drawn: Callable[[np.random.Generator], Change], allowed: tuple[str, ...] = (), **same: float
) -> Cause:
    """A cause in MuJoCo's document, with no detail.

    Args:
        name: of the effect that is right; None outside the library.
        limits: of the size.
        drawn: draws what is changed.
        allowed: names that are not wrong either, see `Form`.
        same: parameters of the effect that are the size times these.
    """

    def cause(random: np.random.Generator) -> Form:
        change = drawn(random)
        sizes = (lambda size: {f"{name}.{each}": factor * size for each, factor in same.items()}) if same else no_sizes
        return Form((name,) if name else (), lambda size: _deviate(change, size), *limits, sizes=sizes, allowed=allowed)

    return cause


def _change_actuator(name: str, kind: str, limits: Limits, field: str, scale: float, parameter: str) -> Cause:
    """A cause in one actuator: a part of its first `gainprm`, or `biasprm` in areas of a bladder.

    Args:
        name: of the effect.
        kind: "pressure" or "tension".
        limits: of the size.
        field: of MuJoCo's actuator.
        scale: sign of the change for a positive parameter.
        parameter: of the effect, that is the size or its opposite.
    """

    def cause(random: np.random.Generator) -> Form:
        which, sign = str(random.choice(MUSCLES)), float(random.choice([-1, 1]))

        def change(spec: Any, body: Body, size: float) -> None:
            actuator = spec.actuator(f"{kind}_{which}")
            values = np.array(getattr(actuator, field))
            values[0] += scale * sign * size * (body.robot.parameters.A if field == "biasprm" else values[0])
            setattr(actuator, field, values)

        full = f"{name}[{which}].{parameter}"
        return Form((name,), lambda size: _deviate(change, size), *limits, {name: which}, lambda size: {full: sign * size})

    return cause


def _load_tip(random: np.random.Generator) -> Change:
    shares = 1 / 3 + (beside := random.uniform(-0.08, 0.08, 3)) - beside.mean()

    def change(spec: Any, body: Body, size: float) -> None:
        for node, share in enumerate(shares):
            spec.body(f"b{body.layout.levels}_{node}").mass += size * share

    return change


def _tilt_gravity(random: np.random.Generator) -> Form:
    name, about = "base_tilt", direction(random, 2)

    def turn(size: float) -> np.ndarray:
        return Rotation.from_rotvec(np.deg2rad([*(size * about), 0.0])).as_matrix()

    def change(spec: Any, body: Body, size: float) -> None:
        mount = body.robot.mount.rotation
        spec.option.gravity = mount.T @ turn(size).T @ mount @ body.gravity

    def sizes(size: float) -> dict[str, float]:
        up = turn(size)[2]  # seen from the base; the effect turns about y, then about x
        return {f"{name}.x": float(np.arcsin(up[1])), f"{name}.y": float(np.arctan2(-up[0], up[2]))}

    return Form((name,), lambda size: _deviate(change, size), 1.0, 1e-2, 10.0, sizes=sizes)


def _pull_tip(random: np.random.Generator) -> Form:
    name, toward = "external_load", direction(random)

    def change(spec: Any, body: Body, size: float) -> None:
        body.load[-1] += size * toward  # what `MujocoWorld` applies to the tip's bodies

    sizes = lambda size: {f"{name}.{axis}": float(part) for axis, part in zip("xyz", size * toward, strict=True)}  # noqa: E731
    return Form((name,), lambda size: _deviate(change, size), 0.02, 1e-4, 0.5, sizes=sizes)


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


def _turn_tracker(random: np.random.Generator) -> Form:
    name, about, along = "sensor_misalignment", direction(random), direction(random) * random.uniform(0.0, 5e-3)  # m a degree

    def deviate(size: float) -> Deviation:
        turn = Rotation.from_rotvec(np.deg2rad(size * about)).as_matrix()
        return Deviation(after=lambda time, points: points @ turn.T + size * along)

    def sizes(size: float) -> dict[str, float]:
        turns = Rotation.from_rotvec(np.deg2rad(size * about)).as_euler("XYZ")  # the effect's order
        named = {"rotation": turns, "shift": size * along}
        return {f"{name}.{kind}_{axis}": float(part) for kind, parts in named.items() for axis, part in zip("xyz", parts, strict=True)}

    return Form((name,), deviate, 1.0, 1e-2, 10.0, sizes=sizes)


def _drift_tracker(random: np.random.Generator) -> Form:
    """A tracker that turns and moves with a sine of the session's time."""
    about, along, period = direction(random), direction(random) * random.uniform(0.0, 5e-3), float(random.uniform(400.0, 2000.0))

    def deviate(size: float) -> Deviation:
        def see(time: np.ndarray, points: np.ndarray) -> np.ndarray:
            part = size * np.sin(2 * np.pi * time / period)[:, None]
            turns = Rotation.from_rotvec(np.deg2rad(part * about)).as_matrix()
            return np.einsum("rij,rpj->rpi", turns, points) + (part * along)[:, None]

        return Deviation(after=see)

    return Form(("tracker_drift",), deviate, 1.0, 1e-2, 20.0)


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
    "heavy_tip": _change_model("payload", (5e-3, 1e-4, 0.1), _load_tip, mass=1.0),
    "leaning_base": _tilt_gravity,
    "pulled_tip": _pull_tip,
    "dry_muscles": _change_model("structural_friction", (0.1, 1e-3, 1.5), _roughen_muscles),
    "filtered_bladders": _change_model("regulator_lag", (0.06, 1e-3, 0.5), _filter_pressures, filling_time=1.0, exhausting_time=1.0),
    "delayed_actuators": _change_model("time_delay", (0.03, 1e-3, 0.3), _delay_actuators, delay=1.0),
    "weak_bladder": _change_actuator("actuator_gain", "pressure", (0.05, 1e-3, 0.5), "gainprm", -1.0, "loss"),
    "weak_motor": _change_actuator("tension_gain", "tension", (0.1, 1e-3, 0.8), "gainprm", -1.0, "loss"),
    "prestressed_bladder": _change_actuator("actuator_offset", "pressure", (4e3, 50.0, 5e4), "biasprm", 1.0, "pressure"),
    "cubic_muscles": _change_model("stiffness_hardening", (100.0, 1.0, 5e3), _harden_muscles, cubic=1.0),
    "reeled_tendons": _change_model("tendon_slack", (0.03, 1e-3, 0.2), _add_reels, ("tendon_friction",)),
    "turned_tracker": _turn_tracker,
    "drifting_tracker": _drift_tracker,
}
"""By key; each form has the name of an effect of the library."""
UNKNOWN: dict[str, Cause] = {
    "touched_wall": _change_model(None, (0.05, 0.03, 0.08), _add_wall),
    "stopped_muscle": _change_model(None, (0.042, 0.03, 0.059), _stop_muscle),
    "rubbing_level": _change_model(None, (0.02, 1e-4, 1.0), _rub_level),
    "viscous_bath": _change_model(None, (0.1, 1e-3, 5.0), _fill_bath),
}
"""By key; no name is right for any of them."""
OTHER_MEANING_IN_MUJOCO = {
    "dry_muscles": ("c_a",),
    "reeled_tendons": ("c_a",),
}
"""Parameters of the robot that mean something else beside a cause: constraints are partly viscous, cables and reels have dampers."""

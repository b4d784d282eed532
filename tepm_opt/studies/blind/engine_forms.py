"""Forms of causes in a robot that an engine moves which is not ours: sizes, names and draws that do not depend on the engine."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tepm_opt.hw.simulation.imperfections.base import Body
from tepm_opt.studies.blind.causes import MUSCLES, Cause, Form, direction, no_sizes
from tepm_opt.studies.blind.machine import Deviation

Change = Callable[[Any, Body, float], None]
"""Changes an engine's document of a robot (`mujoco.MjSpec`, `RodDesign`) and its network in numbers, by a size."""
ActuatorChange = Callable[[Any, Body, str, float], None]
"""Changes one muscle's actuator by its name and a size with a sign, see `Change`."""
Limits = tuple[float, float, float]
"""Usual, smallest and largest size, see `Form`."""


def _deviate(change: Change, size: float) -> Deviation:
    return Deviation(build=lambda spec, body: change(spec, body, size))


def change_model(
    name: str | None, limits: Limits, drawn: Callable[[np.random.Generator], Change], allowed: tuple[str, ...] = (), **same: float
) -> Cause:
    """A cause in an engine's document, with no detail.

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


def change_actuator(name: str, limits: Limits, parameter: str, change: ActuatorChange) -> Cause:
    """A cause in one actuator.

    Args:
        name: of the effect.
        limits: of the size.
        parameter: of the effect, that is the size or its opposite.
        change: of the actuator.
    """

    def cause(random: np.random.Generator) -> Form:
        which, sign = str(random.choice(MUSCLES)), float(random.choice([-1, 1]))
        full = f"{name}[{which}].{parameter}"
        deviate = lambda size: _deviate(lambda spec, body, amount: change(spec, body, which, sign * amount), size)  # noqa: E731
        return Form((name,), deviate, *limits, {name: which}, lambda size: {full: sign * size})

    return cause


def tilt_gravity(set_gravity: Callable[[Any, Body, np.ndarray], None]) -> Cause:
    """A base that is not vertical.

    Args:
        set_gravity: sets the acceleration of what is free, (3,) in m/s², in the base frame of an engine's document.
    """

    def cause(random: np.random.Generator) -> Form:
        name, about = "base_tilt", direction(random, 2)

        def turn(size: float) -> np.ndarray:
            return Rotation.from_rotvec(np.deg2rad([*(size * about), 0.0])).as_matrix()

        def change(spec: Any, body: Body, size: float) -> None:
            mount = body.robot.mount.rotation
            set_gravity(spec, body, mount.T @ turn(size).T @ mount @ body.gravity)

        def sizes(size: float) -> dict[str, float]:
            up = turn(size)[2]  # seen from the base; the effect turns about y, then about x
            return {f"{name}.x": float(np.arcsin(up[1])), f"{name}.y": float(np.arctan2(-up[0], up[2]))}

        return Form((name,), lambda size: _deviate(change, size), 1.0, 1e-2, 10.0, sizes=sizes)

    return cause


def pull_tip(random: np.random.Generator) -> Form:
    """A constant force on the tip."""
    name, toward = "external_load", direction(random)

    def change(spec: Any, body: Body, size: float) -> None:
        body.load[-1] += size * toward  # which a world applies to the tip

    sizes = lambda size: {f"{name}.{axis}": float(part) for axis, part in zip("xyz", size * toward, strict=True)}  # noqa: E731
    return Form((name,), lambda size: _deviate(change, size), 0.02, 1e-4, 0.5, sizes=sizes)


def turn_tracker(random: np.random.Generator) -> Form:
    """A tracker whose frame is turned and shifted."""
    name, about, along = "sensor_misalignment", direction(random), direction(random) * random.uniform(0.0, 5e-3)  # m a degree

    def deviate(size: float) -> Deviation:
        turn = Rotation.from_rotvec(np.deg2rad(size * about)).as_matrix()
        return Deviation(after=lambda time, points: points @ turn.T + size * along)

    def sizes(size: float) -> dict[str, float]:
        turns = Rotation.from_rotvec(np.deg2rad(size * about)).as_euler("XYZ")  # the effect's order
        named = {"rotation": turns, "shift": size * along}
        return {f"{name}.{kind}_{axis}": float(part) for kind, parts in named.items() for axis, part in zip("xyz", parts, strict=True)}

    return Form((name,), deviate, 1.0, 1e-2, 10.0, sizes=sizes)


def drift_tracker(random: np.random.Generator) -> Form:
    """A tracker that turns and moves with a sine of the session's time."""
    about, along, period = direction(random), direction(random) * random.uniform(0.0, 5e-3), float(random.uniform(400.0, 2000.0))

    def deviate(size: float) -> Deviation:
        def see(time: np.ndarray, points: np.ndarray) -> np.ndarray:
            part = size * np.sin(2 * np.pi * time / period)[:, None]
            turns = Rotation.from_rotvec(np.deg2rad(part * about)).as_matrix()
            return np.einsum("rij,rpj->rpi", turns, points) + (part * along)[:, None]

        return Deviation(after=see)

    return Form(("tracker_drift",), deviate, 1.0, 1e-2, 20.0)

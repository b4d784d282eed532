"""Named paths in the size of a robot: where a person gives none, the paper's is scaled to the arm and shrunk until it is in reach."""

from __future__ import annotations

import inspect
from dataclasses import replace
from typing import Any

import numpy as np

from tepm_opt.errors import InputError, unknown_name
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.model import Model
from tepm_opt.models.robot import Robot
from tepm_opt.solvers.kinematics.ik import each_configuration
from tepm_opt.solvers.planning.trajectories import END, HEIGHT, RADIUS, SHAPES, START, Shape, Trajectory

PAPER = 0.400  # m, length of the arm that the shapes' own sizes are for; they lie as high above its base
SHARES = (1.0, 0.75, 0.5, 0.35, 0.25, 0.15)
"""Parts of the paper's size on an arm of this length, tried one after the other until all points are in reach."""
LOOKED_AT = 16  # points of a path, for that
LEVEL = 0.1  # least z component of an arm's axis for which a height says where on it


def path_for(model: CompiledModel, name: str, **given: Any) -> Trajectory:
    """A named path about a robot's arm, in the size of the robot as its file says; on the paper's robot it is the paper's.

    A circle or a lissajous lies across the arm's axis, as far from the base as the arm is long, or where the axis has the given `height`.
    Without a `radius` it is 3/8 (3/10) of the arm's length, or less where that is out of reach; so are the ends of a line. `says` of the
    path tells what became of it.

    Args:
        model: of the robot.
        name: of the shape.
        given: what is chosen of the shape, see `SHAPES`.

    Raises:
        InputError: no such shape, a value that it does not take, or a height of an arm that sticks out sideways.
    """
    if name not in SHAPES:
        raise unknown_name("path", name, SHAPES)
    shape, robot = SHAPES[name], model.robot
    kinds = {parameter.name for parameter in shape.parameters}
    if not kinds & {HEIGHT.name, START.name}:
        return shape.make(**given)
    sizes = {RADIUS.name} if HEIGHT.name in kinds else {START.name, END.name}
    whole = robot.modules * robot.parameters.L_0 / PAPER
    path = _place_shape(robot, shape, whole, given)
    if not sizes <= given.keys():
        nominal = model if model.model == Model.from_robot(robot) else compile_model(robot)
        path = next((each for share in SHARES if _in_reach(nominal, each := _place_shape(robot, shape, share * whole, given))), path)
    if np.array_equal(path.positions, shape.make(**given).positions):
        return path
    middle = ", ".join(f"{value:.3g}" for value in np.round(path.positions.mean(axis=0), 6) + 0.0)
    wide = np.linalg.norm(path.positions - path.positions.mean(axis=0), axis=1).max()
    return replace(path, says=f"{name} in the size of robot {robot.name}: within {wide:.3g} m of ({middle}) m, across the arm")


def _place_shape(robot: Robot, shape: Shape, size: float, given: dict[str, Any]) -> Trajectory:
    """Place a shape about an arm.

    Args:
        robot: whose arm it is.
        shape: with a height, or with ends.
        size: of what is not given, over the paper's.
        given: what is.
    """
    if START.name not in _defaults(shape):
        flat = shape.make(**{name: value for name, value in given.items() if name != HEIGHT.name})
        across = flat.positions[:, :2] * (1.0 if RADIUS.name in given else size)
        return replace(flat, positions=_locate_across_axis(robot, across, given.get(HEIGHT.name)))
    ends = {name: _locate_across_axis(robot, size * np.asarray(_defaults(shape)[name])[None, :2])[0] for name in (START.name, END.name)}
    return shape.make(**{**ends, **given})


def _defaults(shape: Shape) -> dict[str, Any]:
    return {name: parameter.default for name, parameter in inspect.signature(shape.make).parameters.items()}


def _locate_across_axis(robot: Robot, across: np.ndarray, height: float | None = None) -> np.ndarray:
    """Locate points across the arm's axis, (points, 2) in m, in G, (points, 3); at its length or where the axis has a height.

    Raises:
        InputError: the axis is level.
    """
    turn, base = robot.mount.rotation, np.array(robot.mount.base_position_m, dtype=float)
    along = robot.modules * robot.parameters.L_0
    if height is not None:
        if abs(turn[2, 2]) < LEVEL:
            raise InputError(f"height {height:g}: the arm of robot {robot.name} sticks out sideways, which no height cuts; leave it out")
        along = (height - base[2]) / turn[2, 2]
    return np.round(base + along * turn[:, 2], 12) + across @ np.round(turn[:, :2], 12).T


def _in_reach(model: CompiledModel, path: Trajectory) -> bool:
    some = path.positions[:: max(len(path.positions) // LOOKED_AT, 1)]
    return all(found.solved for found in each_configuration(model, some))

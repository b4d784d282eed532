"""A robot for ROS as URDF: the chain of rods through its reference points, whose joints `hw.ros` publishes as /joint_states."""

from __future__ import annotations

import warnings
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from tepm_opt.data.files import write_atomically
from tepm_opt.hw.ros.joints import AXES, RodChain
from tepm_opt.hw.ros.messages import FRAME
from tepm_opt.models.robot import Robot

_COLOUR = "0.16 0.38 0.62 1"


def export_urdf(robot: Robot, path: str | Path) -> None:
    """Write a robot for ROS.

    Args:
        robot: nominal.
        path: of the file.

    Raises:
        InputError: the file cannot be written.
    """
    write_atomically(path, urdf(robot))


def urdf(robot: Robot) -> str:
    """A robot as a URDF document, for display.

    The root link is the tracker's frame G; links s1, s2, … end at the reference points. All joints at zero are the robot at rest.
    """
    chain, mount = RodChain(robot), robot.mount
    root = Xml.Element("robot", name=robot.name)
    root.append(Xml.Comment(" Written by tepm_opt: for display, without dynamics. m, rad. "))
    _add(_add(root, "material", name="rod"), "color", rgba=_COLOUR)
    _link(root, FRAME)
    _link(root, "base")
    with warnings.catch_warnings():  # at gimbal lock any of its angles will do
        warnings.simplefilter("ignore", UserWarning)
        angles = Rotation.from_matrix(mount.rotation).as_euler("xyz")
    _joint(root, "mount", "fixed", (FRAME, "base"), np.asarray(mount.base_position_m), angles)
    parent, start, reach = "base", 0.0, robot.parameters.L_0 * robot.modules
    for point, length in zip(chain.points, chain.lengths.tolist(), strict=True):
        for axis, child in zip(AXES, (f"{point}_fork", f"{point}_rod", point), strict=True):
            link = _link(root, child)
            if axis == "y":
                visual = _add(link, "visual")
                _add(visual, "origin", xyz=(0, 0, length / 2))
                _add(_add(visual, "geometry"), "cylinder", radius=robot.parameters.r, length=length)
                _add(visual, "material", name="rod")
            slides = axis == "z"
            joint = _joint(root, f"{point}_{axis}", "prismatic" if slides else "revolute", (parent, child), np.array([0, 0, start]))
            _add(joint, "axis", xyz=[int(axis == each) for each in AXES])
            most = reach if slides else np.pi
            _add(joint, "limit", lower=-most, upper=most, effort=0, velocity=0)
            parent, start = child, length if axis == "y" else 0.0
    Xml.indent(root)
    return '<?xml version="1.0"?>\n' + Xml.tostring(root, encoding="unicode") + "\n"


def _link(root: Xml.Element, name: str) -> Xml.Element:
    return _add(root, "link", name=name)


def _joint(
    root: Xml.Element, name: str, kind: str, links: tuple[str, str], place: np.ndarray, turn: np.ndarray | None = None
) -> Xml.Element:
    joint = _add(root, "joint", name=name, type=kind)
    _add(joint, "origin", xyz=place, rpy=np.zeros(3) if turn is None else turn)
    for tag, link in zip(("parent", "child"), links, strict=True):
        _add(joint, tag, link=link)
    return joint


def _add(parent: Xml.Element, tag: str, **attributes: ArrayLike) -> Xml.Element:
    texts = {
        name: value if isinstance(value, str) else " ".join(f"{each:.12g}" for each in np.ravel(value))
        for name, value in attributes.items()
    }
    return Xml.SubElement(parent, tag, texts)

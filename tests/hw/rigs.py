"""What the tests of rigs need: a rig small enough for hand calculations, slow ramps, samples in a row.

The "bar" is one module of two wide segments without gravity whose diagonals are a thousandth as stiff as its muscles. So a muscle
is a spring of K_a between base and plate that does not feel the others, and ΔL = (p A − λ) / K_a.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import RigFile
from tepm_opt.models.robot import robot_text

_FOLDER = TemporaryDirectory(prefix="tepm-robots-")
AREA, STIFFNESS, LENGTH, RADIUS, DAMPING = 50.27e-6, 358.86, 0.2, 0.04, 15.50 / 6
BAR = {"modules": 1, "segments_per_module": 2, "alpha_2": 1e-3, "beta_2": 1e-3, "r": 0.12, "base_position_m": (0, 0, 0)}


@cache
def robot_file(**changes: Any) -> str:
    """Path of a robot file: kang2017 with some keys changed; tuples stand for lists."""
    text = robot_text("kang2017")
    for key, value in changes.items():
        value = list(value) if isinstance(value, tuple) else value
        text, count = re.subn(rf"^{key} = [^#\n]*", f"{key} = {value} ", text, count=1, flags=re.MULTILINE)
        assert count == 1, key
    path = Path(_FOLDER.name) / f"robot-{len(list(Path(_FOLDER.name).iterdir()))}.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def rig_of(robot: str = "kang2017", **sections: Any) -> SimulatedRig:
    """A rig that is perfect but for the sections of its file given here."""
    return SimulatedRig(RigFile.model_validate({"name": "test", "robot": robot, **sections}))


def bar(gravity: float = 0.0, sections: dict[str, Any] | None = None, **imperfections: Any) -> SimulatedRig:
    """A bar with imperfections; gravity in m/s² along z, upwards where positive, so that the bar hangs."""
    robot = robot_file(**BAR, gravity_m_per_s2=(0, 0, gravity))
    return rig_of(robot, **(sections or {}), imperfections=imperfections)


def inputs(rig: SimulatedRig, pressure: Any = 0.0, tension: Any = 0.0) -> np.ndarray:
    """u with a pressure in Pa and a tension in N for all actuators, or one for each."""
    count = rig.layout.inputs // 2
    return np.concatenate([np.broadcast_to(pressure, count), np.broadcast_to(tension, count)]).astype(float)


def resting(rig: SimulatedRig, pressure: Any = 0.0, tension: Any = 0.0) -> np.ndarray:
    """Lengths of the actuators in m where the rig rests before time starts."""
    rig.apply(Command.from_inputs(inputs(rig, pressure, tension)))
    return rig.true_lengths


def read_until(rig: SimulatedRig, time: float) -> list[Sample]:
    """Samples up to a time in s."""
    samples = []
    while not samples or samples[-1].time < time - 1e-9:
        samples.append(rig.read())
    return samples


def ramps(rig: SimulatedRig, times: list[float], pressures: list[Any], tension: Any = 0.0) -> None:
    """Schedule pressures in Pa for all actuators (or one for each) that are linear between times in s."""
    rows = np.array([inputs(rig, pressure, tension) for pressure in pressures])
    rig.schedule(SetPoints(np.array(times), rows, np.zeros((len(times), 3))))

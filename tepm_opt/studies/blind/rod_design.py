"""Design of a robot whose body is one Cosserat rod: what causes may change before it is built, and its commands on their way."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tepm_opt.studies.blind.excitation import COUNT


@dataclass
class RodDesign:
    """The rod and its actuators, changed in place by causes before they are built.

    Attributes:
        tip_mass: at the last node in kg.
        share: of the stiffness that each element keeps, (elements,).
        curvature: of the rod without force, (3,) in 1/m.
        cubic: force of a muscle over the cube of its elongation in N.
        viscosity: of the medium in Pa s.
        wall: distance from the axis in m and the direction to it, (3,); None without a wall.
        gains: of pressures and tensions, (12,).
        offset: of the pressures in Pa, (6,).
        filling: time constant of the pressures in s.
        delay: of all inputs in s.
    """

    tip_mass: float = 0.0
    share: np.ndarray = field(default_factory=lambda: np.ones(1))
    curvature: np.ndarray = field(default_factory=lambda: np.zeros(3))
    cubic: float = 0.0
    viscosity: float = 0.0
    wall: tuple[float, np.ndarray] | None = None
    gains: np.ndarray = field(default_factory=lambda: np.ones(2 * COUNT))
    offset: np.ndarray = field(default_factory=lambda: np.zeros(COUNT))
    filling: float = 0.0
    delay: float = 0.0


class ActuatorLine:
    """Way of the inputs from the command to the muscles: delay, first-order lag of the pressures, gains and offsets.

    Args:
        design: of the robot.
        seconds: of a tick, in which inputs stay.
    """

    def __init__(self, design: RodDesign, seconds: float) -> None:
        self._design, self._seconds = design, seconds
        self._sent: list[np.ndarray] = []
        self._pressure = np.zeros(COUNT)

    def settle(self, inputs: np.ndarray) -> np.ndarray:
        """Inputs that act after a long time, (12,) in Pa and N."""
        self._sent, self._pressure = [inputs], inputs[:COUNT]
        return self._change_size(inputs)

    def advance(self, inputs: np.ndarray) -> np.ndarray:
        """Inputs that act in the middle of the next tick, (12,) in Pa and N, where `inputs` are commanded."""
        self._sent.append(inputs)
        ago = self._design.delay / self._seconds
        kept = self._sent = self._sent[-int(ago) - 2 :]
        steps = np.arange(len(kept)) - len(kept) + 1.0
        late = np.array([np.interp(-ago, steps, column) for column in np.transpose(kept)])
        if self._design.filling:
            half = np.exp(-0.5 * self._seconds / self._design.filling)
            goal = late[:COUNT]
            middle = goal + half * (self._pressure - goal)
            self._pressure = goal + half * (middle - goal)
            late = np.append(middle, late[COUNT:])
        return self._change_size(late)

    def _change_size(self, inputs: np.ndarray) -> np.ndarray:
        return self._design.gains * inputs + np.append(self._design.offset, np.zeros(COUNT))

"""Imperfections of a rig: sizes in a rig file, zero where they vanish, and only the hooks that they need.

None of these forms is taken from the model's own effects: each is written in another functional form, so that a test of the
model on the rig proves something.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np

from tepm_opt.data.documents import Section
from tepm_opt.errors import unknown_name
from tepm_opt.models.layout import HORIZONTAL, VERTICAL, Layout
from tepm_opt.models.robot import Robot
from tepm_opt.renamed import adopt_renamed_hook

__all__ = [
    "Body",
    "EdgeStage",
    "Imperfection",
    "Numbers",
    "PressureStage",
    "Section",
    "Sighting",
    "StaticMap",
    "TensionStage",
    "TipStage",
    "of_actuators",
]


@dataclass
class Body:
    """The network in numbers (SPEC section 2), changed in place by imperfections before it moves; base frame, SI.

    Attributes:
        robot, layout: what it was made from.
        stiffness, damping, rest: of the edges, (n, edges) in N/m, N s/m and m, in the order of `Layout.edges`.
        mass: of the free nodes, (n, actuators) in kg.
        gravity: (3,) in m/s².
        load: constant forces on the reference points in the frame G, (points, 3) in N.
        seed: of the rig, for what is drawn once.
    """

    robot: Robot
    layout: Layout
    stiffness: np.ndarray
    damping: np.ndarray
    rest: np.ndarray
    mass: np.ndarray
    gravity: np.ndarray
    load: np.ndarray
    seed: int = 0

    @staticmethod
    def from_robot(robot: Robot, seed: int = 0) -> Body:
        """Make the nominal network of a robot."""
        layout, value = Layout.from_robot(robot), robot.parameters
        nodes = layout.rest_positions(value.r, value.L_0)
        factors = {VERTICAL: (1.0, 1.0), HORIZONTAL: (value.alpha_1, value.beta_1)}
        stiff, damp = np.array([factors.get(edge.kind, (value.alpha_2, value.beta_2)) for edge in layout.edges]).T
        spans = np.array([nodes[edge.b] - nodes[edge.a] for edge in layout.edges])
        n, count = layout.levels, len(layout.edges)
        return Body(
            robot,
            layout,
            stiffness=np.tile(layout.segments * value.K_a * stiff, (n, 1)),
            damping=np.tile(layout.segments * value.c_a * damp, (n, 1)),
            rest=np.tile(np.linalg.norm(spans, axis=1), (n, 1)).reshape(n, count),
            mass=np.full((n, layout.actuators), value.m_d / (layout.actuators * layout.segments)),
            gravity=robot.mount.rotation.T @ np.array(robot.mount.gravity_m_per_s2, dtype=float),
            load=np.zeros((layout.points, 3)),
            seed=seed,
        )

    @property
    def upright(self) -> np.ndarray:
        """Whether each edge is not horizontal (it lies along a segment), (edges,)."""
        return np.array([edge.kind != HORIZONTAL for edge in self.layout.edges])

    @property
    def verticals(self) -> slice:
        """The vertical edges, which come first in `Layout.edges`."""
        return slice(0, self.layout.actuators)


@dataclass(frozen=True, eq=False)
class Numbers:
    """All numbers of a stage, for the compiled engine: scalars, then arrays with a number a channel, the last of them its state.

    Channels are a stage's actuators, (modules · actuators,), or vertical edges, (n, actuators).

    Attributes:
        kind: name of the stage's function in devices.c.
        scalars: any number of them.
        channels: arrays (channels) or (operators or branches, channels).
        count: of its operators or branches, where it has several.
    """

    kind: str
    scalars: tuple[float, ...] = ()
    channels: tuple[np.ndarray, ...] = ()
    count: int = 1


class Stage(Protocol):
    """A stage of the machine; the Protocols below add to it. One without `numbers`, of your own package, runs on MuJoCo's engine only."""

    def numbers(self) -> Numbers:
        """Numbers with which the compiled engine begins, once the stage has settled."""
        ...


class PressureStage(Stage, Protocol):
    """One step on the way from commanded to effective pressure; arrays are (modules · actuators,) in Pa."""

    def settle(self, pressure: np.ndarray) -> np.ndarray:
        """Take the long-time state for a constant pressure and return what comes out."""
        ...

    def step(self, pressure: np.ndarray, duration: float) -> np.ndarray:
        """Turn the values at the start and the end of a tick (linear between), (2, …), into those that come out, (2, …)."""
        ...


class TensionStage(Stage, Protocol):
    """One step on the way from the motor's to the effective tension; arrays are (modules · actuators,) in N, m and m/s."""

    def settle(self, tension: np.ndarray, length: np.ndarray) -> np.ndarray:
        """Take the long-time state for a constant tension and actuator length and return what comes out."""
        ...

    def step(self, tension: np.ndarray, length: np.ndarray, rate: np.ndarray, duration: float) -> np.ndarray:
        """Tensions that come out at the start and the end of a tick, (2, modules · actuators) in N.

        Args:
            tension: what goes in at the start and the end of the tick (linear between), (2, modules · actuators) in N.
            length: of the actuators at the start of the tick, (modules · actuators,) in m.
            rate: of these lengths, (modules · actuators,) in m/s.
            duration: of the tick in s.
        """
        ...


class EdgeStage(Stage, Protocol):
    """A force along the vertical edges besides spring, damper and actuator; arrays are (n, actuators) in m, m/s and N."""

    def settle(self, length: np.ndarray) -> np.ndarray:
        """Take the long-time state at constant lengths and return the force that pushes the ends apart."""
        ...

    def step(self, length: np.ndarray, rate: np.ndarray, duration: float) -> np.ndarray:
        """The force at the start and the end of a tick, (2, n, actuators), from the lengths and rates at its start."""
        ...


class TipStage(Stage, Protocol):
    """A force on the tip that depends on where it is and how it moves, without memory; arrays are (…, 3) in the frame G."""

    def force(self, place: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Force in N of the tip's place in m and velocity in m/s."""
        ...


@dataclass(frozen=True, eq=False)
class Sighting:
    """Knowledge of a sensor's imperfection about the robot that it measures.

    Attributes:
        points: reference points as measured so far, in G, (points, 3) in m.
        nodes: true nodes in G, (n + 1, actuators, 3) in m.
        rest: nodes at rest in the base frame, (n + 1, actuators, 3) in m.
        layout: of the network.
        time: in the session in s.
    """

    points: np.ndarray
    nodes: np.ndarray
    rest: np.ndarray
    layout: Layout
    time: float = 0.0


class StaticMap:
    """A pressure stage without memory: a function, and its numbers for the compiled engine."""

    def __init__(self, function: Callable[[np.ndarray], np.ndarray], numbers: Numbers) -> None:
        self.function, self._numbers = function, numbers

    def numbers(self) -> Numbers:
        """Numbers as given."""
        return self._numbers

    def settle(self, pressure: np.ndarray) -> np.ndarray:
        """The function's value."""
        return self.function(pressure)

    def step(self, pressure: np.ndarray, duration: float) -> np.ndarray:
        """The function's values at both ends of the tick."""
        return self.function(pressure)


def of_actuators(values: Mapping[str, float], layout: Layout, where: str) -> np.ndarray:
    """Values by actuator name as an array, 0 for all others, (modules · actuators,).

    Raises:
        InputError: no such actuator.
    """
    names = layout.actuator_names
    found = np.zeros(len(names))
    for name, value in values.items():
        if name not in names:
            raise unknown_name("actuator", name, names, f"imperfections: {where}")
        found[names.index(name)] = value
    return found


class Imperfection(Section):
    """Base of all imperfections: every key has a default, and with all defaults nothing happens.

    Attributes:
        of_one_actuator: whether a single actuator on a bench has it too.
        of_devices: whether it belongs to the devices, which are the same for any robot.
        of_regulators: whether its pressure stage stands before a pressure monitor, which shows what it does.
    """

    of_one_actuator: ClassVar[bool] = False
    of_devices: ClassVar[bool] = False
    of_regulators: ClassVar[bool] = False

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        adopt_renamed_hook(cls, "shaking", "base_motion")

    @property
    def active(self) -> bool:
        """Whether any key differs from its default."""
        return self != type(self)()

    def change_body(self, body: Body) -> None:
        """Change masses, springs, gravity and constant loads in place."""

    def longest_tick(self, body: Body) -> float:
        """Longest tick in s for which a force that is taken as linear in it is stable.

        Where the force is as stiff as a spring of σ beside a damper of c this is c / σ (unstable from about twice that on).
        """
        return np.inf

    def pressure_stage(self, robot: Robot) -> PressureStage | None:
        """The stage that acts on the pressures, if any."""
        return None

    def tension_stage(self, robot: Robot) -> TensionStage | None:
        """The stage that acts on the tendons' tensions, if any."""
        return None

    def edge_stage(self, body: Body) -> EdgeStage | None:
        """The force along the vertical edges, if any."""
        return None

    def tip_stage(self, robot: Robot) -> TipStage | None:
        """The force that the tip meets, if any."""
        return None

    def base_motion(self, body: Body) -> np.ndarray | None:
        """Motion of the base, if it moves: angular frequency, phase and acceleration in the base frame of sines, (sines, 5), SI."""
        return None

    def measure(self, measured: Sighting) -> np.ndarray:
        """Reference points as the tracker sees them, (points, 3) in m."""
        return measured.points

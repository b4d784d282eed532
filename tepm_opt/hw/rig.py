"""Interface of every rig: read, apply, stop. A controller cannot tell which rig it has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import Protocol

import numpy as np

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.models.robot import Robot
from tepm_opt.renamed import RenamedMethod


@dataclass(frozen=True, eq=False)
class Command:
    """Set points for all actuators, module-major.

    Attributes:
        pressures: (modules · actuators,) in Pa.
        tensions: (modules · actuators,) in N.
        enabled: ENA of the tendon motors, (modules · actuators,); off means that the tendon follows and its tension is 0.
    """

    pressures: np.ndarray
    tensions: np.ndarray
    enabled: np.ndarray

    @staticmethod
    def from_inputs(inputs: np.ndarray) -> Command:
        """Make a command with all motors enabled from u = [pressures, tensions] of shape (2 · modules · actuators,) in Pa and N."""
        inputs = np.asarray(inputs, dtype=float)
        half = len(inputs) // 2
        return Command(inputs[:half], inputs[half:], np.ones(half, dtype=bool))

    of = RenamedMethod("from_inputs")

    def __repr__(self) -> str:
        pressures, tensions = (np.array2string(values, precision=3) for values in (1e-3 * self.pressures, self.tensions))
        return f"Command({pressures} kPa, {tensions} N, {np.count_nonzero(self.enabled)} of {len(self.enabled)} motors on)"


@dataclass(frozen=True, eq=False)
class Sample:
    """Measurements of a rig at one time.

    Attributes:
        time: of the sample in s since the rig's start (when the pose was true, not when it was read).
        points: reference points in the tracker frame G, (points, 3) in m; NaN where the tracker lost one.
        pressures: measured, (modules · actuators,) in Pa; None where the rig does not measure them.
        tensions: measured, (modules · actuators,) in N; None where the rig does not measure them.
        lengths: measured actuator lengths in m; only the single-actuator bench has them.
        transforms: full poses of the tracker's sensors in G, (points, 4, 4) with the position in m; NaN where one was lost, None where the
            rig has only points.
        status: what the rig says about itself; "ok" when all is well.
        extra: other measured numbers by the name of their column.
        stale: numbers of the points, from 0, that were measured and withheld: repeated poses, exchanged points.
        faults: sentences about measurements that are none, by name: "tracker frozen", "pressure gauge 13 frozen".
    """

    time: float
    points: np.ndarray
    pressures: np.ndarray | None = None
    tensions: np.ndarray | None = None
    lengths: np.ndarray | None = None
    transforms: np.ndarray | None = None
    status: str = "ok"
    extra: dict[str, float] = field(default_factory=dict)
    stale: tuple[int, ...] = ()
    faults: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        tip = np.array2string(self.points[-1], precision=4, suppress_small=True)
        return f"Sample({self.time:.3f} s, tip {tip} m, {self.status})"


class Rig(Protocol):
    """A robot, simulated or real. Use it as a context manager: leaving it, also by an exception, stops the robot."""

    @property
    def robot(self) -> Robot:
        """The robot as its file says: what a controller may know."""
        ...

    @property
    def time(self) -> float:
        """Seconds since the rig's start: when a command given now is given."""
        ...

    @property
    def simulated(self) -> Simulated | None:
        """The rig itself where it is a simulation, else None."""
        ...

    def read(self) -> Sample:
        """Wait for the next sample (a full pose where the tracker gives one) and return it; simulated rigs advance virtual time."""
        ...

    def apply(self, command: Command) -> None:
        """Set new set points; the newest wins.

        Raises:
            InputError: a value is NaN or outside the robot's limits; nothing is sent then.
        """
        ...

    def stop(self) -> None:
        """Motors off, pressure to zero."""
        ...

    def __enter__(self) -> Rig:
        """The rig itself."""
        ...

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Stop."""
        ...


class Simulated(Rig, Protocol):
    """A rig of virtual time, which passes only in `read`: it takes set points in advance, and what happens in it is known.

    It rests from the start under what is commanded before the first `read`.
    """

    def reseed(self, noise: int, began: float = 0.0) -> None:
        """Draw other noise for the same machine, before its first `read`; 0 is its own. It starts at a time in the session in s."""
        ...

    def read_many(self, count: int) -> list[Sample]:
        """The next samples, at least one and at most `count`, as `read` would give them one by one if nothing is commanded between them."""
        ...

    def schedule(self, setpoints: SetPoints, linear: bool = True) -> None:
        """Give set points in advance, from now on.

        Args:
            setpoints: inputs (rows, 2 · modules · actuators) in Pa and N, tip forces (rows, 3) in N. All motors are enabled.
            linear: linear between the rows, or each row held until the next.

        Raises:
            InputError: a value is NaN, outside the robot's limits, or a force where the rig cannot push; nothing changes then.
        """
        ...

    def push(self, forces: np.ndarray) -> None:
        """Push the tip from now on with a known force in G, (3,) in N.

        Raises:
            InputError: wrong shape, not finite, or the rig cannot push.
        """
        ...

    @property
    def true_points(self) -> np.ndarray:
        """True reference points at the last sample's time, in G, (points, 3) in m."""
        ...

    @property
    def true_nodes(self) -> np.ndarray:
        """True places of all nodes at the last sample's time, in G, (n + 1, actuators, 3) in m."""
        ...

    @property
    def true_lengths(self) -> np.ndarray:
        """Lengths of the actuators in truth at the last sample's time, (modules · actuators,) in m."""
        ...

"""What every rig offers: read, apply, stop. A controller cannot tell which rig it has."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import TracebackType
from typing import Protocol, runtime_checkable

import numpy as np

from tepm_opt.data.setpoints import SetPoints


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
    def of(inputs: np.ndarray) -> Command:
        """All motors enabled, from u = [pressures, tensions] of shape (2 · modules · actuators,)."""
        pressures, tensions = np.split(np.asarray(inputs, dtype=float), 2)
        return Command(pressures, tensions, np.ones(len(tensions), dtype=bool))


@dataclass(frozen=True, eq=False)
class Sample:
    """What a rig measured.

    Attributes:
        time: of the sample in s since the rig's start (when the pose was true, not when it was read).
        points: reference points in the tracker frame G, (points, 3) in m; NaN where the tracker lost one.
        pressures: measured, (modules · actuators,) in Pa; None where the rig does not measure them.
        tensions: measured, (modules · actuators,) in N; None where the rig does not measure them.
        lengths: measured actuator lengths in m; only the single-actuator bench has them.
        status: what the rig says about itself; "ok" when all is well.
    """

    time: float
    points: np.ndarray
    pressures: np.ndarray | None = None
    tensions: np.ndarray | None = None
    lengths: np.ndarray | None = None
    status: str = "ok"
    extra: dict[str, float] = field(default_factory=dict)


class Rig(Protocol):
    """A robot, simulated or real. Use it as a context manager: leaving it, also by an exception, stops the robot."""

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


@runtime_checkable
class Virtual(Protocol):
    """A rig of virtual time: rests from the start under what is commanded before the first `read`, and takes set points in advance."""

    time: float

    def schedule(self, setpoints: SetPoints, linear: bool = True) -> None:
        """Set points from now on, linear between rows."""
        ...

    def push(self, forces: np.ndarray) -> None:
        """A known force on the tip, (3,) in N."""
        ...

"""Many motions of one network side by side, each in a lane of the vectors of compiled C (see motion_many.c)."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

import numpy as np

from tepm_opt.models.backends.ccode import Unit
from tepm_opt.models.backends.compiled import stepping_unit
from tepm_opt.models.backends.interface import MAX_CORRECTION, STATUSES, Drive, Effort, Record, Scheme, Status
from tepm_opt.models.dynamics import Dynamics

KERNELS = ("input_motion", "properties", "observe", "segment_motion", "segment_tangent")
LOOPS = (
    "real.c", "rotations.c", "time_stepping.c", "motion_alone.c", "motion_many_network.c", "motion_newton.c", "motion_steps.c",
    "motion_adaptive.c", "motion_rounds.c", "motion_many.c",
)  # fmt: skip
SYMBOLS = ("pool_lanes", "pool_size", "pool_open", "pool_enter", "pool_move", "pool_look", "pool_leave")
ALIGNED = 64  # bytes of the widest vectors
ROUNDS = 200  # steps or pairs of steps that a call takes: some milliseconds, so that Ctrl-C and progress come through


def many_unit(dynamics: Dynamics) -> Unit:
    """The C of `ManyStepper`, with as many lanes as the vectors of the compiler's target have."""
    sizes = {name: size for name, size in stepping_unit(dynamics).sizes.items() if name != "LANES"} | {"MANY": 1}
    kernels = {name: dynamics.functions[name] for name in ("delay", *KERNELS)}
    return Unit(kernels, sizes, {}, LOOPS, SYMBOLS, tuple(kernels), "many_motions")


@dataclass(frozen=True, eq=False)
class Motion:
    """What a lane is given.

    Attributes:
        x: equilibrium from which it starts, (n + 1, block) in m.
        drive: inputs and forces at all samples; no directions.
        theta: parameters, (parameters,) in SI.
        step: longest one of equal steps in s; 0 where they adapt.
        ends: numbers of the samples at which its parts end, increasing.
        record: what is filled.
    """

    x: np.ndarray
    drive: Drive
    theta: np.ndarray
    step: float
    ends: np.ndarray
    record: Record


class ManyStepper:
    """What `Pool`s are made with."""

    def __init__(self, library: ctypes.CDLL) -> None:
        p, i, n, d = ctypes.c_void_p, ctypes.c_int, ctypes.c_long, ctypes.c_double
        self.library = library
        self.lanes: int = library.pool_lanes()
        library.pool_size.restype = n
        self.size: int = library.pool_size()
        for name, arguments in {
            "pool_open": [p, i, d, i, d, d],
            "pool_enter": [p, i, i, n, p, p, d, p, p, p, p, p, n, p, n],
            "pool_move": [p, n],
            "pool_look": [p, i, p, p, p],
            "pool_leave": [p, i],
        }.items():
            getattr(library, name).argtypes = arguments
            if name != "pool_look":
                getattr(library, name).restype = None

    def pool(self, scheme: Scheme) -> Pool:
        """An empty pool.

        Args:
            scheme: of all motions; only the length of equal steps is theirs.
        """
        return Pool(self, scheme)


class Pool:
    """Motions that move together; of one thread."""

    def __init__(self, stepper: ManyStepper, scheme: Scheme) -> None:
        self._library = stepper.library
        self._memory = np.zeros(stepper.size + ALIGNED, np.uint8)
        self._at = self._memory.ctypes.data + -self._memory.ctypes.data % ALIGNED
        self._held: list[tuple[Any, ...] | None] = [None] * stepper.lanes  # what C reads and writes
        self._parts = [0] * stepper.lanes
        goal = 0.0 if scheme.step > 0 else scheme.error
        self._library.pool_open(self._at, scheme.kind, goal, scheme.smooth, scheme.tolerance, MAX_CORRECTION)

    @property
    def empty(self) -> list[int]:
        """Lanes without a motion."""
        return [lane for lane, held in enumerate(self._held) if held is None]

    def enter(self, lane: int, motion: Motion) -> None:
        """Put a motion in an empty lane."""
        drive, record = motion.drive, motion.record
        theta, x, time, rows, knots = map(np.ascontiguousarray, (motion.theta, motion.x, drive.time, drive.rows, drive.knots))
        ends = np.ascontiguousarray(motion.ends, ctypes.c_long)
        self._library.pool_enter(
            self._at, lane, drive.hold, len(time), time.ctypes.data, rows.ctypes.data, motion.step,
            theta.ctypes.data, x.ctypes.data, record.observed.ctypes.data, record.trajectory.ctypes.data,
            knots.ctypes.data, len(knots), ends.ctypes.data, len(ends),
        )  # fmt: skip
        self._held[lane] = theta, x, time, rows, knots, ends, record
        self._parts[lane] = len(ends)

    def move(self) -> None:
        """Move all motions on by some steps, or until one is over."""
        self._library.pool_move(self._at, ROUNDS)

    def look(self, lane: int) -> tuple[bool, Status, Effort, int]:
        """Whether the motion in a lane is over, how it ended, what it took, and how many of its parts are done."""
        info, status, left = np.zeros(7), ctypes.c_int(), ctypes.c_long()
        over = self._library.pool_look(self._at, lane, info.ctypes.data, ctypes.byref(status), ctypes.byref(left))
        return bool(over), STATUSES[status.value], Effort(*info.tolist()), self._parts[lane] - left.value

    def leave(self, lane: int) -> None:
        """Empty a lane."""
        self._library.pool_leave(self._at, lane)
        self._held[lane] = None

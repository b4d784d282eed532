"""Compiled backends: the loops of statics.c, kinematics.c and time_stepping.c called through ctypes."""

from __future__ import annotations

import ctypes
import threading
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np

from tepm_opt.models.backends.ccode import Unit
from tepm_opt.models.backends.interface import (
    GUARDS,
    LANES,
    MAX_CORRECTION,
    MODES,
    SHARED,
    STATUSES,
    Allotment,
    InverseNewton,
    InverseProblem,
    LoadCase,
    Pose,
    Solution,
    Status,
)
from tepm_opt.models.backends.motion_interface import Drive, Effort, Record, Scheme
from tepm_opt.models.backends.step_control import STEP_CONTROL
from tepm_opt.models.dynamics import Dynamics
from tepm_opt.models.effect import BEGAN, CLOCK
from tepm_opt.models.network import ROWS, Network

AT_ONCE = 32
"""Configurations that one call makes: some milliseconds, so that Ctrl-C and progress come through."""


STATICS = ("rotations.c", "statics.c")
"""Loops of statics, without what is called from outside."""


def statics_unit(network: Network) -> Unit:
    """The C of `CompiledStatics`."""
    layout = network.layout
    sizes = {
        **SHARED,
        "NB": layout.block,
        "NLEV": layout.levels,
        "NPROP": max(rows.stop for rows in network.property_rows.values()),
        "NDRIVEN": len(network.driven),
        "ROWS": ROWS,
        "NU": layout.inputs,
        "NEXT": 3 * layout.points,
        "NPOINT": 3 * layout.points,
        "NLEN": layout.inputs // 2,
        "NMODE": min(MODES, layout.levels * layout.block),
        "NSHAPE": min(MODES + GUARDS, layout.levels * layout.block),
    }
    symbols = ("actuation", "statics", "sensitivity", "matrices", "inverse", "response", "allocate", "configurations", "modal")
    return Unit(
        network.functions,
        sizes,
        {"NTHETA": len(network.parameter_names)},
        {"DRIVEN": network.driven},
        (*STATICS, "statics_calls.c", "kinematics.c", "modal.c"),
        symbols,
        stem="statics",
    )


class _Arrays(threading.local):
    """The arrays C reads and writes, one set a thread, so that a call costs copies and no address look-ups."""

    def __init__(self, network: Network) -> None:
        layout, parameters = network.layout, len(network.parameter_names)
        observations = 3 * layout.points + layout.inputs // 2
        shapes = {
            "x": (layout.levels + 1, layout.block),
            "u": (layout.inputs,),
            "a": (layout.inputs,),
            "external": (3 * layout.points,),
            "theta": (parameters,),
            "observed": (observations,),
            "targets": (layout.inputs // 2,),
            "info": (3,),
            "weights": (observations, observations),
            "by_u": (observations, layout.inputs),
            "by_external": (observations, 3 * layout.points),
            "by_theta": (observations, parameters),
            "stiffness": (layout.levels * layout.block, 2 * layout.block),
            "damping": (layout.levels * layout.block, 2 * layout.block),
            "forces": (layout.inputs // 2,),
            **dict.fromkeys(("start", "limit", "grid", "inputs", "rounded"), (layout.inputs,)),
            **dict.fromkeys(("its_start", "its_limit", "its_grid"), (layout.inputs,)),
            **dict.fromkeys(("its_low", "its_high"), (layout.inputs // 2,)),
            "its_external": (3 * layout.points,),
            "its_theta": (parameters,),
            "its_weights": (layout.inputs // 2, observations),
            "all_targets": (AT_ONCE, 3),
            "all_x": (AT_ONCE, layout.levels + 1, layout.block),
            "all_a": (AT_ONCE, layout.inputs),
            "all_observed": (AT_ONCE, observations),
            "all_inputs": (AT_ONCE, layout.inputs),
            "all_rounded": (AT_ONCE, layout.inputs),
            "all_info": (AT_ONCE, 4),
        }
        self.array = {name: np.zeros(shape) for name, shape in shapes.items()}
        self.address = {name: array.ctypes.data for name, array in self.array.items()}
        self.problem: InverseProblem | None = None  # whose arrays `its_…` are


class CompiledStatics:
    """Backend of compiled C (see `StaticsBackend`); thread-safe."""

    def __init__(self, network: Network, library: ctypes.CDLL) -> None:
        self.network = network
        p, i, d = ctypes.c_void_p, ctypes.c_int, ctypes.c_double
        self._actuation, self._statics, self._sensitivity = library.actuation, library.statics, library.sensitivity
        self._actuation.argtypes = [p, p, p]
        self._statics.argtypes = [p, p, i, p, p, d, i, p, p]
        self._inverse = library.inverse
        self._inverse.argtypes = [p, p, p, p, p, p, d, d, d, i, p]
        self._sensitivity.argtypes = [p, p, i, p, p, i, p, p, p, p]
        self._matrices = library.matrices
        self._matrices.argtypes = [p, p, i, p, p, p, p]
        self._response = library.response
        self._response.argtypes = [p, p, p, p, i, p, d, i, p, p, p]
        self._allocate = library.allocate
        self._allocate.argtypes, self._allocate.restype = [p, p, p, p, p, d, i, p, p], d
        self._configurations = library.configurations
        self._configurations.argtypes = [i, p, i, *[p] * 7, d, d, d, d, i, p, p, p, d, i, *[p] * 7]
        self.modal = ctypes.cast(library.modal, p).value
        """Address of `modal` of modal.c, for compiled controllers."""
        self._arrays = _Arrays(network)

    def actuation(self, u: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """See `StaticsBackend.actuation`."""
        array, at = self._arrays.array, self._arrays.address
        array["u"][:], array["theta"][:] = u, theta
        if STATUSES[self._actuation(at["u"], at["theta"], at["a"])] != Status.SOLVED:
            raise MemoryError("no room for the effective actuation")
        return array["a"].copy()

    def statics(self, x: np.ndarray, case: LoadCase, tolerance: float, max_iterations: int) -> Solution:
        """See `StaticsBackend.statics`."""
        array, at = self._arrays.array, self._arrays.address
        array["x"][:], array["u"][:], array["external"][:], array["theta"][:] = x, case.u, case.external, case.theta
        status = self._statics(
            at["x"], at["u"], case.mapped, at["external"], at["theta"], tolerance, max_iterations, at["observed"], at["info"]
        )
        return Solution(STATUSES[status], array["x"].copy(), array["observed"].copy(), *array["info"].tolist())

    def sensitivity(
        self, x: np.ndarray, case: LoadCase, weights: np.ndarray, by_theta: bool
    ) -> tuple[Status, np.ndarray, np.ndarray, np.ndarray | None]:
        """See `StaticsBackend.sensitivity`."""
        array, at, rows = self._arrays.array, self._arrays.address, len(weights)
        array["x"][:], array["u"][:], array["external"][:], array["theta"][:] = x, case.u, case.external, case.theta
        array["weights"][:rows] = weights
        status = self._sensitivity(
            at["x"], at["u"], case.mapped, at["external"], at["theta"], rows, at["weights"],
            at["by_u"], at["by_external"], at["by_theta"] if by_theta else None,
        )  # fmt: skip
        gradient = array["by_theta"][:rows].copy() if by_theta else None
        return STATUSES[status], array["by_u"][:rows].copy(), array["by_external"][:rows].copy(), gradient

    def matrices(self, x: np.ndarray, case: LoadCase) -> tuple[np.ndarray, np.ndarray]:
        """See `StaticsBackend.matrices`; the storage is column by column, as LAPACK has it."""
        array, at = self._arrays.array, self._arrays.address
        array["x"][:], array["u"][:], array["external"][:], array["theta"][:] = x, case.u, case.external, case.theta
        self._matrices(at["x"], at["u"], case.mapped, at["external"], at["theta"], at["stiffness"], at["damping"])
        return array["stiffness"].copy().T, array["damping"].copy().T

    def inverse(
        self, x: np.ndarray, case: LoadCase, weights: np.ndarray, targets: np.ndarray, newton: InverseNewton
    ) -> tuple[Status, np.ndarray, np.ndarray, int]:
        """See `StaticsBackend.inverse`."""
        array, at, half = self._arrays.array, self._arrays.address, len(targets)
        array["x"][:], array["a"][:half], array["a"][half:] = x, case.u[:half], 0.0
        array["external"][:], array["theta"][:], array["weights"][:half], array["targets"][:] = case.external, case.theta, weights, targets
        status = self._inverse(
            at["x"], at["a"], at["external"], at["theta"], at["weights"], at["targets"],
            newton.max_step, newton.target_tolerance, newton.tolerance, newton.max_iterations, at["info"],
        )  # fmt: skip
        return STATUSES[status], array["x"].copy(), array["a"][:half].copy(), int(array["info"][0])

    def response(
        self, x: np.ndarray, case: LoadCase, weights: np.ndarray, tolerance: float, max_iterations: int
    ) -> tuple[Status, np.ndarray, np.ndarray, np.ndarray]:
        """See `StaticsBackend.response`."""
        array, at, rows = self._arrays.array, self._arrays.address, len(weights)
        array["x"][:], array["a"][:], array["external"][:], array["theta"][:] = x, case.u, case.external, case.theta
        array["weights"][:rows] = weights
        status = self._response(
            at["x"], at["a"], at["external"], at["theta"], rows, at["weights"], tolerance, max_iterations,
            at["observed"], at["by_u"], at["info"],
        )  # fmt: skip
        return STATUSES[status], array["x"].copy(), array["observed"].copy(), array["by_u"][:rows].copy()

    def allocate(self, forces: np.ndarray, allotment: Allotment, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """See `StaticsBackend.allocate`."""
        array, at = self._arrays.array, self._arrays.address
        array["forces"][:], array["theta"][:] = forces, theta
        array["start"][:], array["limit"][:], array["grid"][:] = allotment.start, allotment.limit, allotment.grid
        missed = self._allocate(
            at["forces"], at["theta"], at["start"], at["limit"], at["grid"], allotment.area, allotment.fine, at["inputs"], at["rounded"]
        )
        return array["inputs"].copy(), array["rounded"].copy(), missed

    def configurations(
        self, problem: InverseProblem, targets: np.ndarray, x: np.ndarray, actuation: np.ndarray, cold: bool
    ) -> tuple[list[Pose], Status]:
        """See `StaticsBackend.configurations`."""
        array, at, count, by = self._arrays.array, self._arrays.address, min(len(targets), AT_ONCE), problem.allotment
        if self._arrays.problem is not problem:
            for name in ("external", "theta", "weights", "low", "high"):
                array[f"its_{name}"][:] = getattr(problem, name)
            array["its_start"][:], array["its_limit"][:], array["its_grid"][:] = by.start, by.limit, by.grid
            self._arrays.problem = problem
        array["x"][:], array["a"][:], array["all_targets"][:count] = x, actuation, targets[:count]
        solved = ctypes.c_int()
        status = self._configurations(
            count, at["all_targets"], cold, at["x"], at["a"], at["its_external"], at["its_theta"], at["its_weights"], at["its_low"],
            at["its_high"], problem.max_step / by.area, problem.tolerance, problem.force_tolerance, problem.shortest,
            problem.max_iterations, at["its_start"], at["its_limit"], at["its_grid"], by.area, by.fine,
            at["all_x"], at["all_a"], at["all_observed"], at["all_inputs"], at["all_rounded"], at["all_info"], ctypes.byref(solved),
        )  # fmt: skip
        done = solved.value
        columns = [array[f"all_{name}"][:done].copy() for name in ("x", "a", "observed", "inputs", "rounded")]
        return list(map(Pose, *columns, *array["all_info"][:done].T.tolist())), STATUSES[status]


STEPPING = (
    "rotations.c", "time_stepping.c", "motion_network.c", "motion_tangents.c", "motion_newton.c", "motion_steps.c",
    "motion_adaptive.c", "motion_rounds.c", "motion_one.c",
)  # fmt: skip


def stepping_unit(dynamics: Dynamics) -> Unit:
    """The C of `CompiledTimeStepper`."""
    layout = dynamics.layout
    properties = dynamics.functions["properties"].size1_out(0)
    sizes = {
        **SHARED,
        **STEP_CONTROL,
        "NB": layout.block,
        "NLEV": layout.levels,
        "NPROP": properties,
        "MASS": properties - 1,
        "NU": layout.inputs,
        "NEXT": 3 * layout.points,
        "NOBS": 3 * layout.points + layout.inputs // 2,
        "NEDGES": len(layout.edges),
        "NIN": dynamics.input_states,
        "NEDGE": dynamics.edge_states,
    }
    names = dynamics.parameter_names
    counts = {"NTHETA": len(names)} | {name.upper(): names.index(name) for name in (CLOCK, BEGAN) if name in names}
    sizes |= {"TIMED": int(CLOCK in names)}
    symbols, lanes = ("integrate", "state_size", "tangent_size"), ("segment_motion", "segment_tangent", "segment_by")
    return Unit(dynamics.functions, sizes, counts, {}, STEPPING, symbols, lanes)


def stepping_alone_unit(dynamics: Dynamics) -> Unit:
    """The C of one motion that is not differentiated, to be called by what stands below it in the same unit."""
    full = stepping_unit(dynamics)
    jacobians = [name for name in full.kernels if name.endswith("_by")]
    kernels = {name: function for name, function in full.kernels.items() if name not in jacobians}
    sizes = {**full.sizes, **{f"{name}_nnz_ROOM": 1 for name in jacobians}}
    loops = tuple("motion_alone.c" if name == "motion_tangents.c" else name for name in STEPPING[:-1])
    return replace(full, kernels=kernels, sizes=sizes, loops=loops, lanes=full.lanes[:2], symbols=())


class CompiledTimeStepper:
    """Backend of compiled C (see `TimeStepper`); thread-safe."""

    def __init__(self, dynamics: Dynamics, library: ctypes.CDLL) -> None:
        self.dynamics = dynamics
        self._integrate, self._sizes = library.integrate, (library.state_size(), library.tangent_size())
        self._packed: WeakKeyDictionary[Drive, np.ndarray] = WeakKeyDictionary()
        p, i, n, d = ctypes.c_void_p, ctypes.c_int, ctypes.c_long, ctypes.c_double
        self._integrate.argtypes = [i, i, n, n, n, p, p, d, d, i, d, d, p, p, p, p, i, p, p, p, p, p, n, p]

    def start(self, x: np.ndarray, directions: int) -> tuple[np.ndarray, np.ndarray]:
        """See `TimeStepper.start`."""
        state, tangents = np.zeros(self._sizes[0]), np.zeros((2, -(-directions // LANES), self._sizes[1]))
        state[: x.size] = x.ravel()
        return state, tangents

    def integrate(
        self, state: tuple[np.ndarray, np.ndarray], drive: Drive, first: int, last: int, scheme: Scheme, record: Record
    ) -> tuple[Status, Effort]:
        """See `TimeStepper.integrate`."""
        carried, tangents = state
        directions, groups, samples = len(drive.d_theta), tangents.shape[1], len(drive.time)
        d_theta = _in_lanes(drive.d_theta, groups)
        d_rows = self._rows_along(drive, groups)
        time, rows = np.ascontiguousarray(drive.time), np.ascontiguousarray(drive.rows)
        d_observed = np.zeros((samples if groups else 0, groups, record.observed.shape[1], LANES))
        info = np.zeros(7)
        status = self._integrate(
            scheme.kind, drive.hold, first, last, samples, time.ctypes.data, rows.ctypes.data, scheme.step, scheme.error, scheme.smooth,
            scheme.tolerance, MAX_CORRECTION, drive.theta.ctypes.data, carried.ctypes.data, record.observed.ctypes.data,
            record.trajectory.ctypes.data, groups, d_theta.ctypes.data, None if d_rows is None else d_rows.ctypes.data,
            tangents.ctypes.data, d_observed.ctypes.data, drive.knots.ctypes.data, len(drive.knots), info.ctypes.data,
        )  # fmt: skip
        if groups:
            new = slice(first + 1 if first else 0, last + 1)
            flat = d_observed[new].swapaxes(1, 2).reshape(-1, record.observed.shape[1], groups * LANES)
            record.d_observed[new] = flat[:, :, :directions]
        return STATUSES[status], Effort(*info.tolist())

    def _rows_along(self, drive: Drive, groups: int) -> np.ndarray | None:
        """Changes of the rows in lanes, made once for all parts of a motion."""
        if drive.d_rows is None:
            return None
        if drive not in self._packed:
            self._packed[drive] = _in_lanes(drive.d_rows, groups)
        return self._packed[drive]


def _in_lanes(values: np.ndarray, groups: int) -> np.ndarray:
    """Directions in groups of LANES, filled with zeros: (…, directions, n) as (…, groups, n, LANES)."""
    *front, directions, n = values.shape
    padded = np.zeros((*front, groups * LANES, n))
    padded[..., :directions, :] = values
    return padded.reshape(*front, groups, LANES, n).swapaxes(-1, -2).copy()

"""The predictive controller's step in C (state.c says how it is laid out): prepared without a sample, then fed with one."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from itertools import pairwise
from operator import itemgetter
from typing import Any

import numpy as np

from tepm_opt.control.actuation.regulator_lags import RegulatorFindings
from tepm_opt.control.controller import Telemetry, Value
from tepm_opt.control.diagnostics.sensors import SensorDiagnostics
from tepm_opt.control.estimation.kalman_filter import DiscreteModalModel, StateEstimate
from tepm_opt.control.mpc.compiled.layout import SYMBOLS
from tepm_opt.control.mpc.compiled.setup import FITS, StepSetup
from tepm_opt.control.mpc.record import LATE, Step
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.models.backends import ccode, compiler
from tepm_opt.models.backends.compiled import CompiledStatics
from tepm_opt.models.compile import CompiledModel
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.solvers.linear.modal_model import ModalModel

OUTCOMES = (
    Outcome(Ending.SOLVED), Outcome(Ending.INFEASIBLE, "no x is within all bounds"), Outcome(Ending.ITERATION_LIMIT, "no answer in time"),
    Outcome(Ending.NOT_FINITE, "a coefficient or a bound is not a finite number"),
    Outcome(Ending.NOT_CONVEX, "the Hessian is not positive definite"),
    Outcome(Ending.FAILED, "the answer is outside its bounds by more than rounding"), Outcome(Ending.SOLVED),
)  # fmt: skip
"""By the status of a program; the last one was solved too late."""
ALIGNED = 64  # bytes
_NOWHERE = "no stable equilibrium to linearise about: its stiffness matrix has a negative eigenvalue"


class _Course(ctypes.Structure):
    """`course` of state.c."""

    _fields_ = [("rows", ctypes.c_long)] + [
        (name, ctypes.c_void_p)
        for name in (
            *("levels", "inputs", "loads", "forces", "lengths", "tips", "points", "mapped"),
            *("theta", "masses", "by", "basis", "values", "free"),
        )
    ]


class CompiledStep:
    """The step of one controller; not for several threads at once."""

    def __init__(self, setup: StepSetup, library: ctypes.CDLL, doubts: SensorDiagnostics) -> None:
        self._setup, self._doubts, sizes = setup, doubts, setup.sizes
        p, d = ctypes.c_void_p, ctypes.c_double
        library.step_size.restype = library.step_outcome.restype = ctypes.c_long
        library.step_open.argtypes, library.step_open.restype = [p, p, p, p, p, p, ctypes.c_int], None
        # calls that keep the interpreter's lock: a thread that has it for long (the journal's) would make the command late
        takes = {"step_prepare": [p], "step_feedback": [p, d, d, p, p, p]}
        self._prepare, self._feedback = (ctypes.PYFUNCTYPE(ctypes.c_int, *kinds)(_address(library, name)) for name, kinds in takes.items())
        self._point = ctypes.PYFUNCTYPE(None, p, p)(_address(library, "step_point"))
        self._distrust = ctypes.PYFUNCTYPE(None, p)(_address(library, "step_distrust_monitors"))
        memory = np.zeros(library.step_size() + ALIGNED, np.uint8)
        begin = -memory.ctypes.data % ALIGNED
        self._at = memory.ctypes.data + begin
        first = begin + library.step_outcome()
        ends: list[int] = np.cumsum([0, *sizes.results.values()]).tolist()
        self._out = memory[first : first + 8 * ends[-1]].view(float)  # keeps all of the memory
        self._part = {name: slice(*pair) for name, pair in zip(sizes.results, pairwise(ends), strict=True)}
        self._held, settings = setup.course(), setup.values
        course = _Course(len(setup.reference), **{name: array.ctypes.data for name, array in self._held.items()})
        begin_at = [np.ascontiguousarray(part, dtype=float) for part in (setup.first.pressures, setup.first.tensions * setup.first.enabled)]
        modal = _statics(setup.model).modal
        library.step_open(
            self._at, settings.ctypes.data, ctypes.addressof(course), modal, *(part.ctypes.data for part in begin_at), sizes.ahead
        )
        self._points = np.zeros((sizes.points, 3))
        self._gauges = np.zeros((2, sizes.actuators))
        self._addresses = self._points.ctypes.data, self._gauges[0].ctypes.data, self._gauges[1].ctypes.data
        self._seen: np.ndarray | None = None  # results of the last step
        self.fallbacks: dict[str, int] = {}
        self._picked = self._columns()

    @staticmethod
    def from_setup(setup: StepSetup, doubts: SensorDiagnostics) -> CompiledStep | None:
        """The compiled step of a setup, as its backend asks for; None, where that is "auto", if there is none for it or no compiler.

        Raises:
            InputError: backend "c" where the step cannot be in C.
        """
        insists = setup.controller.backend == "c"
        if setup.controller.backend == "python" or not (setup.fits or insists):
            return None
        if not setup.fits:
            raise InputError(f"backend 'c': {setup}; valid: {FITS}")
        instead = "the predictive controller steps in Python, with the same commands, some ten times slower"
        library = compiler.build([compiler.Part("step", setup.source, ccode.FLAGS)], "step", SYMBOLS, instead)
        if library is None and insists:
            raise InputError("backend 'c': no working C compiler; install one or use backend 'auto'")
        return CompiledStep(setup, library, doubts) if library else None

    def prepare(self) -> None:
        """See `ControlStep`."""
        if self._prepare(self._at):
            raise InputError(_NOWHERE)

    def feedback(self, sample: Sample, deadline: float) -> Command:
        """See `ControlStep`."""
        if sample.points.shape != self._points.shape:
            raise InputError(f"points: shape {sample.points.shape}; valid: {self._points.shape}")
        self._points[:] = sample.points
        points, pressures, tensions = self._addresses
        if sample.pressures is None:
            pressures = None
        else:
            self._gauges[0][:] = sample.pressures
        if sample.tensions is None:
            tensions = None
        else:
            self._gauges[1][:] = sample.tensions
        if self._feedback(self._at, sample.time, deadline, points, pressures, tensions):
            raise InputError(_NOWHERE)
        self._seen, part = self._out.copy(), self._part
        if status := int(self._seen[part["status"]][0]):
            reason = LATE if OUTCOMES[status].solved else OUTCOMES[status].ending.value
            self.fallbacks[reason] = self.fallbacks.get(reason, 0) + 1
        return Command(self._seen[part["pressures"]], self._seen[part["tensions"]], self._setup.first.enabled.copy())

    @property
    def noise(self) -> float:
        """See `ControlStep`."""
        return float(self._out[self._part["noise"]][0])

    @property
    def ahead(self) -> int:
        """See `ControlStep`."""
        return int(self._out[self._part["ahead"]][0]) if self._seen is not None else self._setup.sizes.ahead

    @property
    def last(self) -> Step | None:
        """See `ControlStep`."""
        if self._seen is None:
            return None
        get = {name: self._seen[part] for name, part in self._part.items()}
        one = {name: float(values[0]) for name, values in get.items() if len(values) == 1}
        sizes = self._setup.sizes
        count, modes = sizes.actuators, 2 * sizes.modes
        unknown, strength, friction, hysteresis = get["state"][modes : modes + 4 * count].reshape(4, count)
        estimate = StateEstimate(
            self._read_operating_point(int(one["row"])), get["state"][:modes], unknown, strength, friction, get["direction"], hysteresis,
            get["turning"], get["deviation"], get["state"][modes + 4 * count :].reshape(-1, 3), get["points"].reshape(-1, 3), one["nis"],
            int(one["seen"]), get["refused"].astype(bool),
        )  # fmt: skip
        return Step(
            int(one["row"]), estimate, get["pressures"], get["tensions"], int(one["moves"]), get["against"], get["plan"].reshape(-1, count),
            OUTCOMES[int(one["status"])], int(one["iterations"]), (one["seconds"], float("nan")),
        )  # fmt: skip

    def _read_operating_point(self, row: int) -> DiscreteModalModel:
        """The operating point of the last estimate."""
        sizes = self._setup.sizes
        modes, outputs, reference = sizes.modes, 3 * sizes.points, self._setup.reference
        shapes = [(sizes.free, sizes.shapes), (sizes.shapes,), (modes, modes), (modes, sizes.actuators), (outputs, modes)]
        shapes += [(outputs, sizes.actuators), (2 * modes, 2 * modes), (2 * modes, modes), (2 * modes, modes)]
        found = [np.zeros(shape) for shape in shapes]
        self._point(self._at, (ctypes.c_void_p * len(found))(*(array.ctypes.data for array in found)))
        basis, values, damping, drive, observe, gain, *discrete = found
        weights, row = basis[:, :modes].T * self._held["masses"], int(reference.rows_at(row))
        model = ModalModel(reference.equilibria[row], basis, weights, values[:modes], damping, drive, observe, gain)
        A, start, end = discrete
        return DiscreteModalModel(model, reference.forces[row], A, start, end, reference.period)

    def _columns(self) -> tuple[list[str], Callable[[list[float]], tuple[float, ...]]]:
        """Names of the log's columns, and what picks their values from the results."""
        sizes, part = self._setup.sizes, {name: found.start for name, found in self._part.items()}
        tip, friction = part["points"] + 3 * (sizes.points - 1), part["state"] + 2 * sizes.modes + 2 * sizes.actuators
        columns = {f"estimated_tip_{axis}_m": tip + k for k, axis in enumerate("xyz")}
        for k, name in enumerate(self._setup.model.layout.actuator_names):
            columns[f"unknown_force_{name}_N"], columns[f"friction_{name}_N"] = part["against"] + k, friction + k
            columns[f"tension_offset_{name}_N"] = part["tension_offset"] + k
            columns[f"pressure_offset_{name}_Pa"] = part["pressure_offset"] + k
        named = {"nis": "nis", "coordinates_seen": "seen", "points_refused": "refusals", "tracked_noise_m": "noise", "program": "status"}
        named |= {"iterations": "iterations", "pressure_moves": "moves", "program_seconds": "seconds"}
        columns |= {name: part[what] for name, what in named.items()}
        return list(columns), itemgetter(*columns.values())

    def distrust_monitors(self) -> None:
        """See `ControlStep`."""
        self._distrust(self._at)

    def telemetry(self) -> Telemetry:
        """See `ControlStep`; the program's time is that of the whole feedback."""
        if self._seen is None:
            return Telemetry()
        now, part, (names, pick) = self._out.tolist(), self._part, self._picked
        columns: dict[str, Value] = dict(zip(names, pick(now), strict=True))
        columns["program"] = OUTCOMES[int(now[part["status"].start])].ending.value
        doubts: Mapping[str, str] = {}
        if now[part["doubtful"].start]:
            lasting = {kind: self._out[part[f"lasting_{kind}"]] for kind in ("pressure", "tension")}
            offsets = {kind: self._out[part[f"{kind}_offset"]] for kind in lasting}
            noise = now[part["noise"].start], self._setup.noise
            quicker = self._out[part["quicker"]].reshape(2, -1)
            regulators = RegulatorFindings(quicker, self._out[part["monitor_noise"]], now[part["common"].start])
            doubts = self._doubts.sentences(lasting, offsets, noise, now[part["late"].start], regulators)
        return Telemetry(columns, dict(self.fallbacks), doubts)


def _address(library: ctypes.CDLL, name: str) -> int:
    """Address of a function of a library."""
    return ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0


def _statics(model: CompiledModel) -> CompiledStatics:
    """The model's compiled statics.

    Raises:
        InputError: it is not in C.
    """
    statics: Any = model.statics
    if not isinstance(statics, CompiledStatics):
        raise InputError("model: in Python; valid: a model in C for a compiled step")
    return statics

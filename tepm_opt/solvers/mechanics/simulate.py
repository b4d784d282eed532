"""Motion of the network under inputs and known forces over time, from rest, with sensitivities along the way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal
from weakref import WeakKeyDictionary

import numpy as np

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError, unknown_name
from tepm_opt.models.backends.interface import EXPLICIT, IMPLICIT, LoadCase, Status
from tepm_opt.models.backends.motion_interface import Drive, Effort, Record, Scheme
from tepm_opt.models.compile import CompiledModel
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.progress import Progress, silent
from tepm_opt.renamed import RenamedMethod
from tepm_opt.solvers.mechanics.statics import THROUGH_BASE, Equilibrium, solve_statics
from tepm_opt.solvers.mechanics.step_limit import stable_step
from tepm_opt.solvers.numerics.text import format_names

Method = Literal["implicit", "rk4"]
METHODS: tuple[Method, ...] = ("implicit", "rk4")
ERROR = 1e-4  # m at which implicit steps aim where nothing else is asked for
LEAST_ERROR, MOST_ERROR = 1e-7, 0.1  # m, the least above what Newton's residuals leave
BEND = 30.0  # 1/s: bends of the inputs that change the points' speed by more than this times the error asked for end a step
ANY_BEND = 1e3  # m/N and m/Pa, as if inputs moved what nothing holds at the start: every bend matters
SAFETY = 0.9  # of the largest stable RK4 step, for what happens between the samples it is computed at
CHUNK = 1.0  # s of simulated time between two reports of progress

MOST_LIMITS = 100  # of a model that are remembered
_LIMITS: WeakKeyDictionary[CompiledModel, dict[bytes, float]] = WeakKeyDictionary()  # stable steps by the rows they are computed at


class SimulationError(RuntimeError):
    """A simulation that is needed to its last sample did not get there; the message says why."""


@dataclass(frozen=True, eq=False)
class Directions:
    """Changes of parameters and inputs along which a simulation is differentiated.

    Attributes:
        names: one a direction.
        parameters: change of theta, (directions, parameters).
        inputs: change of u at every sample, (samples, directions, inputs), or at all of them alike, (directions, inputs).
        loads: change of the forces on the points at every sample, (samples, directions, points, 3), or at all of them alike,
            (directions, points, 3).
    """

    names: tuple[str, ...]
    parameters: np.ndarray
    inputs: np.ndarray | None = None
    loads: np.ndarray | None = None

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Directions({format_names(self.names)})"

    @staticmethod
    def from_names(model: CompiledModel, parameters: Sequence[str] = (), inputs: Sequence[str] = ()) -> Directions:
        """Unit changes of parameters by full name and of whole input histories by name ("pressure_11", "tension_23").

        Raises:
            InputError: no such parameter or input.
        """
        known = model.network.parameter_names
        half = model.layout.actuator_names
        channels = [f"pressure_{name}" for name in half] + [f"tension_{name}" for name in half]
        for kind, names, valid in (("parameter", parameters, known), ("input", inputs, channels)):
            for name in names:
                if name not in valid:
                    raise unknown_name(kind, name, valid)
        theta = np.zeros((len(parameters) + len(inputs), len(known)))
        u = np.zeros((len(theta), len(channels)))
        for k, name in enumerate(parameters):
            theta[k, known.index(name)] = 1.0
        for k, name in enumerate(inputs, start=len(parameters)):
            u[k, channels.index(name)] = 1.0
        return Directions((*parameters, *inputs), theta, u if len(inputs) else None)

    of = RenamedMethod("from_names")


@dataclass(frozen=True, eq=False)
class Simulation:
    """Motion at the samples of its set points, all of them or, where it ended early, those until then.

    Attributes:
        model: of which.
        start: equilibrium under the first row.
        setpoints: inputs and tip force.
        points: reference points in G, (samples, points, 3) in m.
        lengths: actuator lengths, (samples, modules · actuators) in m.
        levels, velocities: levels 0 … n in the base frame, (samples, n + 1, 3 · actuators) in m and m/s.
        sensitivities: change of points along each direction, (directions, samples, points, 3), in m per unit of the direction.
        directions: their names.
        method, step: how it was done; the longest step in s.
        error: estimate of the nodes' largest error in m over all samples; NaN where the step was given. Not a bound: of 360 motions of
            ten machines it was too small in nine, up to eight times where every effect with corners acted at once.
        effort: steps and iterations it took.
        outcome: SOLVED; FAILED where the motion left all bounds or a stage had no solution; INTERRUPTED by Ctrl-C.
    """

    model: CompiledModel
    start: Equilibrium
    setpoints: SetPoints
    points: np.ndarray
    lengths: np.ndarray
    levels: np.ndarray
    velocities: np.ndarray
    sensitivities: np.ndarray
    directions: tuple[str, ...]
    method: Method
    step: float
    error: float
    effort: Effort
    outcome: Outcome

    def __repr__(self) -> str:
        """The outcome and the main numbers, in a line."""
        time = self.setpoints.time
        passed = float(time[-1] - time[0]) if len(time) else 0.0
        how = f"{self.method}, steps up to {1e3 * self.step:.3g} ms" + (
            "" if np.isnan(self.error) else f", error {1e3 * self.error:.2g} mm"
        )
        return f"Simulation({self.outcome.ending}, {len(time)} samples in {passed:.4g} s, {how})"

    @property
    def solved(self) -> bool:
        """Whether it came to the last sample."""
        return self.outcome.solved

    def complete(self) -> Simulation:
        """This simulation, where it came to the last sample: for those who can do nothing with a part.

        Raises:
            SimulationError: it failed.
            KeyboardInterrupt: the user interrupted it.
        """
        if self.outcome.ending is Ending.INTERRUPTED:
            raise KeyboardInterrupt
        if not self.solved:
            raise SimulationError(self.outcome.message)
        return self

    @property
    def tip(self) -> np.ndarray:
        """Tip in G, (samples, 3) in m."""
        return self.points[:, -1]


def simulate(
    model: CompiledModel, setpoints: SetPoints, method: Method = "implicit", step: float | None = None, hold: bool = False,
    loads: np.ndarray | None = None, directions: Directions | None = None, tolerance: float = 1e-6,
    progress: Progress = silent, error: float | None = None, began: float = 0.0,
) -> Simulation:  # fmt: skip
    """Simulate from the equilibrium under the first row; the result's outcome says whether it came to the last.

    Implicit steps adapt, unless their length is given: the result's `error` estimates how far nodes are from the motion of ever
    shorter steps. Sensitivities are those of the steps taken.

    A motion that leaves all bounds, an implicit stage without a solution and Ctrl-C end it early, with the samples until then.

    Args:
        model: compiled model, with its effects.
        setpoints: inputs over time; its rows are also the times of the result. Tip forces act on the last reference point.
        method: "implicit" (Crouzeix's SDIRK, order 3) or "rk4" (the paper's scheme).
        step: longest step in s, between samples of equal ones; by default steps adapt, those of "rk4" are 0.9 of the stable one.
        hold: rows hold until the next one, instead of changing linearly.
        loads: further known forces on the reference points in G, (samples, points, 3) in N.
        directions: what to differentiate by; "implicit" only.
        tolerance: residual forces in N to which implicit stages are solved.
        progress: told the time simulated in s, about once per simulated second.
        error: of the nodes in m at which adaptive steps aim. Default: 0.1 mm.
        began: time in the session in s at the first row, for effects that ask.

    Raises:
        InputError: set points that do not fit, "rk4" with a step above its stable one, with directions or with an error, both an
            error and a step, no stable equilibrium to start from.
    """
    if method not in METHODS:
        raise unknown_name("method", method, METHODS)
    if directions is not None and method == "rk4":
        raise InputError("directions: sensitivities are computed by method 'implicit'")
    if error is not None and (method == "rk4" or step is not None):
        raise InputError("error: steps adapt to it with method 'implicit' and without a step")
    if error is not None and not LEAST_ERROR <= error <= MOST_ERROR:
        raise InputError(f"error: {error:g} m; valid: {LEAST_ERROR:g} … {MOST_ERROR:g} m")
    _ = model.stepper  # compiled now: the model of every time shares it
    model = model.at_time(began)
    drive = _drive(model, setpoints, hold, loads, directions)
    start = _start(model, setpoints, 0, drive)
    if method == "rk4":
        step = _stable_step(model, setpoints, drive, step)
    if step is not None and not step > 0:
        raise InputError(f"step: {step:g} s; valid: above 0")
    scheme = Scheme(EXPLICIT if method == "rk4" else IMPLICIT, step or 0.0, error or ERROR, model.is_smooth, tolerance)
    if step is None:
        drive = replace(drive, knots=_knots(model, drive, start, scheme.error))
    names = directions.names if directions is not None else ()
    record = Record.empty(model.stepper.dynamics, len(drive.time), len(names))
    ends = np.unique(np.append(np.searchsorted(drive.time, np.arange(drive.time[0] + CHUNK, drive.time[-1], CHUNK)), len(drive.time) - 1))
    return run(Job(model, setpoints, method, step, start, drive, scheme, record, names, ends), progress)


@dataclass(frozen=True, eq=False)
class Job:
    """A simulation that is prepared.

    Attributes:
        model, setpoints, method: see `simulate`; the model as it is when the motion begins.
        step: longest of equal steps in s; None where they adapt.
        start: equilibrium under the first row.
        drive, scheme, record: what the backend is told, and what it fills.
        names: of the directions.
        ends: numbers of the samples at which its parts end, about 1 s each.
    """

    model: CompiledModel
    setpoints: SetPoints
    method: Method
    step: float | None
    start: Equilibrium
    drive: Drive
    scheme: Scheme
    record: Record
    names: tuple[str, ...]
    ends: np.ndarray

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Job({self.method}, {len(self.drive.time)} samples in {len(self.ends)} parts)"

    def finish(self, status: Status, parts: int, effort: Effort) -> Simulation:
        """Simulation after so many parts, cut where a plate on a guide has run through the one below."""
        if (through := self.model.layout.run_through(self.record.trajectory[:, 0])).any():
            first, time = int(np.argmax(through)), self.drive.time
            return self._simulation(first, effort, Outcome(Ending.FAILED, f"{THROUGH_BASE} after {time[first] - time[0]:.4g} s"))
        if status == Status.SOLVED:
            return self._simulation(len(self.drive.time), effort, Outcome())
        why = "left all bounds" if status == Status.DIVERGED else "has no solution nearby"
        hint = "a shorter step may help" if self.method == "rk4" or status == Status.DIVERGED else "inputs may jump too far"
        message = f"the motion {why} after {effort.reached:.4g} s ({hint}; step {self.step or effort.longest:g} s)"
        return self._simulation(int(self.ends[parts - 1]) + 1 if parts else 1, effort, Outcome(status.ending, message))

    def finish_interrupted(self, parts: int, effort: Effort) -> Simulation:
        """Simulation after so many parts, as far as it is when the user interrupts it."""
        rows = int(self.ends[parts - 1]) + 1 if parts else 0
        return self._simulation(rows, effort, Outcome(Ending.INTERRUPTED, "interrupted by the user"))

    def _simulation(self, rows: int, effort: Effort, outcome: Outcome) -> Simulation:
        kept, points, setpoints, record = slice(rows), 3 * self.model.layout.points, self.setpoints, self.record
        observed, directions = record.observed[kept], len(self.names)
        sensitivities = np.moveaxis(record.d_observed[kept, :points].reshape(rows, points // 3, 3, directions), -1, 0)
        return Simulation(
            self.model, self.start, SetPoints(setpoints.time[kept], setpoints.inputs[kept], setpoints.tip_force[kept]),
            observed[:, :points].reshape(rows, points // 3, 3), observed[:, points:],
            record.trajectory[kept, 0], record.trajectory[kept, 1], sensitivities, self.names, self.method,
            *((effort.longest, effort.error) if self.step is None else (self.step, np.nan)), effort, outcome,
        )  # fmt: skip


def run(job: Job, progress: Progress) -> Simulation:
    """Simulate what is prepared."""
    time, state, total, done = job.drive.time, job.model.stepper.start(job.start.x, len(job.names)), Effort(), 0
    try:
        for part, end in enumerate(job.ends):
            status, effort = job.model.stepper.integrate(state, job.drive, done, int(end), job.scheme, job.record)
            total = _sum(total, effort)
            if status != Status.SOLVED:
                return job.finish(status, part, total)
            done = int(end)
            progress("simulation", float(time[done] - time[0]), float(time[-1] - time[0]))
    except KeyboardInterrupt:
        return job.finish_interrupted(int((job.ends <= done).sum()), total)
    return job.finish(Status.SOLVED, len(job.ends), total)


def _stable_step(model: CompiledModel, setpoints: SetPoints, drive: Drive, step: float | None) -> float:
    """RK4's step: the one given, or a safe one, from the equilibria under the first row and under the one with most pressure.

    Raises:
        InputError: it is above the stable one.
    """
    fullest = np.argmax(setpoints.inputs[:, : model.layout.inputs // 2].sum(axis=1))
    rows = sorted({0, int(fullest)})
    known, key = _LIMITS.setdefault(model, {}), drive.rows[rows].tobytes()
    if key not in known:
        if len(known) >= MOST_LIMITS:
            known.clear()
        equilibria = [_start(model, setpoints, int(row), drive, strict=row == 0) for row in rows]
        known[key] = min(stable_step(found) for found in equilibria if found.solved or found.indifferent)
    limit = known[key]
    if step is not None and step > limit:
        raise InputError(f"step: {1e3 * step:.4g} ms; valid with 'rk4': at most {1e3 * limit:.4g} ms, or the method 'implicit'")
    return SAFETY * limit if step is None else step


def _drive(model: CompiledModel, setpoints: SetPoints, hold: bool, loads: np.ndarray | None, directions: Directions | None) -> Drive:
    samples, points = len(setpoints.time), model.layout.points
    if samples < 2:
        raise InputError(f"set points: {samples} rows; valid: at least 2, the motion lasts from the first to the last")
    if not (np.diff(setpoints.time) > 0).all():
        raise InputError(f"set points: time does not increase after row {int(np.argmin(np.diff(setpoints.time) > 0)) + 1}")
    if setpoints.inputs.shape != (samples, len(model.input_max)) or not model.allows(setpoints.inputs):
        for row, u in enumerate(setpoints.inputs):
            model.check_inputs(u, f"set points: row {row + 1}")
    forces = np.zeros((samples, points, 3)) if loads is None else np.array(loads, dtype=float)
    if forces.shape != (samples, points, 3):
        raise InputError(f"loads: shape {forces.shape}; valid: {(samples, points, 3)}")
    forces[:, -1] += setpoints.tip_force
    if not np.isfinite(forces).all():
        raise InputError("loads: a force is not finite; valid: numbers")
    rows = np.hstack([setpoints.inputs, forces.reshape(samples, -1)])
    if directions is None:
        return Drive(setpoints.time, rows, hold, model.theta, np.zeros((0, len(model.theta))))
    d_rows = None
    if directions.inputs is not None or directions.loads is not None:
        d_rows = np.zeros((samples, len(directions.names), rows.shape[1]))
        if directions.inputs is not None:
            d_rows[:, :, : model.layout.inputs] = directions.inputs
        if directions.loads is not None:
            d_rows[:, :, model.layout.inputs :] = directions.loads.reshape(*directions.loads.shape[:-2], -1)
    return Drive(setpoints.time, rows, hold, model.theta, directions.parameters, d_rows)


def _knots(model: CompiledModel, drive: Drive, start: Equilibrium, error: float) -> np.ndarray:
    """Times in s at which inputs or forces jump, where they hold, or bend by as much as matters beside the error in m.

    What a bend matters is taken from the gain at the start: by how much it changes the speed with which the points follow.
    """
    inputs, points = model.layout.inputs, 3 * model.layout.points
    parts = drive.rows[:, :inputs], drive.rows[:, inputs:]
    if drive.hold:
        found = [drive.time[1:][(np.diff(part, axis=0) != 0).any(axis=1)] for part in parts]
    else:
        weights = np.eye(points, points + inputs // 2)
        a = model.statics.actuation(start.inputs, model.theta)  # effects' maps may have dead zones where it starts
        status, *gains = model.statics.sensitivity(start.x, LoadCase(a, True, start.loads.ravel(), model.theta), weights, False)[:3]
        gains = gains if status == Status.SOLVED else [np.full_like(gain, ANY_BEND) for gain in gains]  # nothing holds it
        bends = [
            np.diff(np.diff(part, axis=0) / np.diff(drive.time)[:, None], axis=0) @ gain.T for part, gain in zip(parts, gains, strict=True)
        ]
        speeds = [np.linalg.norm(bend.reshape(len(bend), points // 3, 3), axis=2).max(axis=1, initial=0.0) for bend in bends]
        found = [drive.time[1:-1][speed > BEND * error] for speed in speeds]
    late = [model.delays(times - drive.time[0], forces) for times, forces in zip(found, (False, True), strict=True)]
    for _ in range(2 if model.model.timed else 0):  # they act when it is later, which may change how late
        late = [model.delays(times + after - drive.time[0], k == 1) for k, (times, after) in enumerate(zip(found, late, strict=True))]
    return np.unique(np.concatenate([times + after for times, after in zip(found, late, strict=True)]))


def _start(model: CompiledModel, setpoints: SetPoints, row: int, drive: Drive, strict: bool = True) -> Equilibrium:
    forces = drive.rows[row, model.layout.inputs :].reshape(-1, 3)
    found = solve_statics(model, setpoints.inputs[row], forces)
    if strict and not (found.solved or found.indifferent):
        raise InputError(f"set points: row {row + 1}: no stable equilibrium to start from: {found.outcome.message}")
    return found


def _sum(a: Effort, b: Effort) -> Effort:
    counted = {name: getattr(a, name) + getattr(b, name) for name in ("steps", "iterations", "factors", "halvings")}
    return replace(b, **counted, longest=max(a.longest, b.longest))

"""Motion after a step of pressure: ours beside CVODES, MuJoCo and the practical limit; sensitivities, size, step, a whole data set."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.dynamics_peers import MujocoRun, cvodes, cvodes_name
from benchmarks.goals import Goal
from benchmarks.limit import Limit
from benchmarks.parts import Session
from benchmarks.scene import Scene
from benchmarks.timing import Contender, Task
from benchmarks.workshop import Workshop
from tepm_opt.data.channels import Channels
from tepm_opt.data.datasets import read_dataset
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.models.backends.interface import EXPLICIT
from tepm_opt.models.backends.motion_interface import Drive, Record, Scheme
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.solvers.mechanics.simulate import Directions, Simulation, simulate
from tepm_opt.solvers.mechanics.statics import solve_statics

DURATION, SAMPLE = 3.0, 0.02  # s, as in time_limit.py
REST = 1e-4  # s at rest before the pressure steps, which takes ours one more step
RK4_STEP = 1e-3 / 3
PEER_STEPS = (20, 10, 5)  # ms, beside the peers
STEPS = (20, 10, 20 / 3, 5, 4, 2.5, 2)  # ms; each divides a sample
ERRORS = (10e-3, 5e-3, 3e-3, 1e-3, 1e-4)  # m, asked of adaptive steps beside the peers
SIZES_ERROR = 1e-3  # m
SEGMENTS = (2, 4, 6, 12, 24)
DIRECTIONS = 20
STEPPER = "tepm_opt model.stepper, rk4"
LENGTHS = (22, 24, 20, 31, 31, 25, 24)  # s, of runs that are made up
IMPLICIT, RK4, CVODES, MUJOCO = "tepm_opt simulate, implicit", "tepm_opt simulate, rk4", "CVODES", "MuJoCo, RK4"
IMPLICIT_LIMITS = ("midpoint", "alpha")
FINE_STEP, FINE_TOLERANCE = 2.5e-4, 1e-9  # s and N, of the converged run
CLOSE = 1e-3  # m, largest error of what a target compares
LARGEST = 20e-3  # m, error above which a contender is not timed further


def _step_of_pressure(model: CompiledModel, high: np.ndarray) -> SetPoints:
    """From rest to constant inputs at time 0, for `simulate` with `hold`."""
    time = np.append(-REST, SAMPLE * np.arange(round(DURATION / SAMPLE) + 1))
    inputs = np.tile(high, (len(time), 1))
    inputs[0] = 0.0
    return SetPoints(time, inputs, np.zeros((len(time), 3)))


def _ms(step: float) -> str:
    return f"{step:.3g} ms"


@dataclass(frozen=True)
class _Step:
    """The step of pressure of one model and its converged tips, (samples, 3) from the first sample after the step on."""

    model: CompiledModel
    setpoints: SetPoints
    converged: np.ndarray

    @staticmethod
    def of(model: CompiledModel, high: np.ndarray) -> _Step:
        setpoints = _step_of_pressure(model, high)
        return _Step(model, setpoints, simulate(model, setpoints, step=FINE_STEP, hold=True, tolerance=FINE_TOLERANCE).complete().tip[2:])

    def error(self, tips: np.ndarray) -> np.ndarray:
        """Distance from the converged tips at every sample."""
        return np.linalg.norm(tips - self.converged, axis=1)

    def implicit(self, name: str, step: float) -> Contender:
        """Ours at a step in ms."""
        return Contender(
            name,
            lambda: simulate(self.model, self.setpoints, step=1e-3 * step, hold=True).complete(),
            lambda found: self.error(found.tip[2:]),
            ours=True,
        )

    def adaptive(self, name: str, error: float) -> Contender:
        """Ours with steps that adapt to an error in m."""
        return Contender(
            name,
            lambda: simulate(self.model, self.setpoints, error=error, hold=True).complete(),
            lambda found: self.error(found.tip[2:]),
            ours=True,
        )

    def task(self, key: str, title: str, contenders: Sequence[Contender]) -> Task:
        """Contenders whose answer is their error at every sample."""
        return Task(key, title, np.zeros(len(self.converged)), list(contenders), LARGEST, DURATION)

    def explicit(self) -> Iterator[Contender]:
        """Ours by RK4, with `simulate`'s check of the step and without."""
        model = self.model
        rows = np.hstack([self.setpoints.inputs, np.zeros((len(self.setpoints.time), 3 * model.layout.points))])
        drive = Drive(self.setpoints.time, rows, True, model.theta, np.zeros((0, len(model.theta))))
        scheme = Scheme(EXPLICIT, RK4_STEP)
        rest, last = solve_statics(model, rows[0, : model.layout.inputs]), len(rows) - 1

        def stepped() -> np.ndarray:
            record = Record.empty(model.stepper.dynamics, len(rows), 0)
            model.stepper.integrate(model.stepper.start(rest.x, 0), drive, 0, last, scheme, record)
            return record.observed[2:, 3 * model.layout.points - 3 : 3 * model.layout.points]

        yield Contender(
            f"{RK4}, 1/3 ms",
            lambda: simulate(model, self.setpoints, "rk4", RK4_STEP, hold=True).complete(),
            lambda found: self.error(found.tip[2:]),
            ours=True,
        )
        yield Contender(f"{STEPPER}, 1/3 ms: no check of the step", stepped, self.error, ours=True)


def _beside_peers(scene: Scene, workshop: Workshop, step: _Step, quick: bool) -> Task:
    times = step.setpoints.time[1:]
    contenders = [step.implicit(f"{IMPLICIT}, {_ms(size)}", size) for size in PEER_STEPS]
    contenders += [step.adaptive(f"{IMPLICIT}, {1e3 * error:g} mm asked for", error) for error in ERRORS]
    contenders += step.explicit()

    def tips(states: np.ndarray) -> np.ndarray:
        return np.array([scene.tip_of(state) for state in states[:, : scene.network.x.numel()]])

    for name, solve in cvodes(scene, workshop, times, quick):
        contenders.append(Contender(name, solve, lambda found: step.error(tips(found.full().T))))
    machine = MujocoRun(scene, RK4_STEP, SAMPLE, len(times) - 1)
    contenders.append(Contender(f"{MUJOCO}, 1/3 ms", machine.simulate, lambda found: step.error(tips(machine.coordinates(found)))))
    return step.task("motion", f"Step to 0.15 MPa in p_11 and p_21, {DURATION:g} s", contenders)


def _sensitivities(step: _Step) -> Task:
    """Plain and with directions at 10 ms; the latter checked by a central difference along all parameters at once, in m per 100 %."""
    model, part = step.model, 1e-4
    names = model.network.parameter_names
    channels = [f"{kind}_{name}" for kind in ("pressure", "tension") for name in model.layout.actuator_names]
    directions = Directions.from_names(model, names, channels[: DIRECTIONS - len(names)])

    def along(found: Simulation) -> np.ndarray:
        return np.tensordot(model.theta, found.sensitivities[: len(names), :, -1], 1)[2:].ravel()

    def changed(factor: float) -> np.ndarray:
        return (
            simulate(model.with_theta(factor * model.theta), step.setpoints, step=10e-3, hold=True, tolerance=1e-10)
            .complete()
            .tip[2:]
            .ravel()
        )

    expected = (changed(1 + part) - changed(1 - part)) / (2 * part)
    sensitive = Contender(
        f"{IMPLICIT}, 10 ms, {DIRECTIONS} directions",
        lambda: simulate(model, step.setpoints, step=10e-3, hold=True, directions=directions).complete(),
        lambda found: np.abs(along(found) - expected).max(),
        ours=True,
    )
    plain = step.implicit(f"{IMPLICIT}, 10 ms", 10)
    title = f"Sensitivities for {len(names)} parameters and {DIRECTIONS - len(names)} inputs"
    return Task("sensitivities", title, np.zeros(1), [plain, sensitive], CLOSE, DURATION)


def _sizes(scene: Scene) -> Task:
    """One model for each n_e, each compiled and judged by its own converged run."""
    contenders, steps = [], []
    for count in SEGMENTS:
        robot = scene.model.robot
        robot = robot.model_copy(update={"geometry": robot.geometry.model_copy(update={"segments_per_module": count})})
        steps.append(_Step.of(compile_model(robot, backend="c"), scene.bent.inputs))
        contenders.append(steps[-1].adaptive(f"n_e = {count}, {1e3 * SIZES_ERROR:g} mm asked for", SIZES_ERROR))
    return steps[0].task("segments", f"The same step with n_e segments a module, {DURATION:g} s", contenders)


def random_runs(model: CompiledModel, lengths: Sequence[float] = LENGTHS) -> list[SetPoints]:
    """Runs, of 177 s in all, whose inputs move linearly every 2 s from 0 to random values up to 40 % of their range."""
    random, runs = np.random.default_rng(1), []
    for length in lengths:
        time, knots = SAMPLE * np.arange(round(length / SAMPLE) + 1), np.arange(0, length + 2, 2.0)
        values = 0.4 * random.random((len(knots), model.layout.inputs)) * model.input_max
        values[0] = 0.0
        inputs = np.stack([np.interp(time, knots, column) for column in values.T], axis=1)
        runs.append(SetPoints(time, inputs, np.zeros((len(time), 3))))
    return runs


def _data_set(model: CompiledModel, folder: Path | None) -> Task:
    """Simulations of all runs; errors are those from the recorded tips, of made-up runs from a step of 1 ms."""
    if folder is None:
        runs, kind = random_runs(model), "made-up runs"
        points = [simulate(model, run, step=1e-3).complete().points for run in runs]
    else:
        found = read_dataset(folder, Channels(model.layout.actuator_names, model.layout.point_names))
        runs, kind = [SetPoints(run.time, run.inputs, run.tip_force) for run in found.runs], f"runs of {folder.name}"
        points = [run.points for run in found.runs]

    def errors(simulations: list[Simulation]) -> np.ndarray:
        return np.concatenate([np.linalg.norm(a.tip - b[:, -1], axis=1) for a, b in zip(simulations, points, strict=True)])

    def all_runs(**how: Any) -> Callable[[], Any]:
        return lambda: [simulate(model, run, **how).complete() for run in runs]

    contenders = [Contender(f"{IMPLICIT}, default: 0.1 mm asked for", all_runs(), errors, ours=True)]
    contenders += [Contender(f"{IMPLICIT}, {_ms(1e3 * step)}", all_runs(step=step), errors, ours=True) for step in (10e-3, 20e-3)]
    length = sum(float(run.time[-1] - run.time[0]) for run in runs)
    title = f"A data set, {length:g} s: {len(runs)} {kind}"
    return Task("data", title, np.zeros(sum(map(len, points))), contenders, LARGEST, length)


def tasks(session: Session) -> list[Task]:
    """All tasks; robot and inputs are those of time_limit.py."""
    scene = session.scene
    step = _Step.of(scene.model, scene.bent.inputs)
    curve = [step.implicit(_ms(size), size) for size in STEPS]
    return [
        _beside_peers(scene, session.workshop, step, session.quick),
        step.task("steps", f"Implicit: error and cost against the step, {DURATION:g} s", curve),
        _sensitivities(step),
        _sizes(scene),
        _data_set(scene.model, session.reference),
    ]


def rounds(of_others: int) -> int:
    """Rounds of these tasks, whose calls are longer."""
    return of_others // 4


def fastest(task: Task, start: str) -> Contender | None:
    """The fastest contender that errs by at most 1 mm among those whose names start like this."""
    close = [one for one in task.contenders if one.name.startswith(start) and one.right and one.error <= CLOSE]
    return min(close, key=lambda one: one.median, default=None)


def exponents(task: Task) -> tuple[float, float]:
    """Exponents of a power law of cost over n_e: fitted to all sizes, and between the two largest."""
    if not all(one.right and one.times for one in task.contenders):
        return np.nan, np.nan
    cost, size = np.log([one.median for one in task.contenders]), np.log(SEGMENTS)
    return float(np.polyfit(size, cost, 1)[0]), float((cost[-1] - cost[-2]) / (size[-1] - size[-2]))


def _speed_up(ours: str, peer: str) -> Callable[[Task, Limit], float]:
    def figure(task: Task, limit: Limit) -> float:
        mine, other = fastest(task, ours), fastest(task, peer)
        return other.over(mine) if mine and other else np.nan

    return figure


def _over_limit(task: Task, limit: Limit) -> float:
    mine = fastest(task, IMPLICIT)
    return mine.median / min(limit.median(key) for key in IMPLICIT_LIMITS) if mine else np.nan


def _over_limit_alike(task: Task, limit: Limit) -> float:
    return task.named(f"{IMPLICIT}, 5 ms").median / min(limit.median(key) for key in IMPLICIT_LIMITS)


GOALS = (
    Goal(
        "motion",
        "motion within 1 mm, over CVODES",
        "implicit: at least 10 times faster than CVODES, fastest of each within 1 mm",
        _speed_up(IMPLICIT, CVODES),
        10,
        True,
    ),
    Goal(
        "motion",
        "motion within 1 mm, over CVODES at its defaults",
        "the same, CVODES at its default tolerances",
        _speed_up(IMPLICIT, cvodes_name("default tolerances")),
        10,
        True,
    ),
    Goal(
        "motion",
        "motion within 1 mm, over MuJoCo RK4",
        "implicit: at least 50 times faster than MuJoCo RK4, fastest within 1 mm",
        _speed_up(IMPLICIT, MUJOCO),
        50,
        True,
    ),
    Goal(
        "motion",
        "motion within 1 mm, over the limit at 5 ms",
        "implicit: at most 3 times the limit's faster implicit scheme at 5 ms, fastest within 1 mm",
        _over_limit,
        3,
    ),
    Goal("motion", "motion at 5 ms, over the limit", "the same, ours at 5 ms, too", _over_limit_alike, 3),
    Goal("motion", "RK4, over MuJoCo RK4", "RK4: at least 12 times faster than MuJoCo RK4", _speed_up(RK4, MUJOCO), 12, True),
    Goal(
        "motion", "RK4 without its check, over MuJoCo RK4", "the same without the check of the step", _speed_up(STEPPER, MUJOCO), 12, True
    ),
    Goal(
        "sensitivities",
        "sensitivities in 20 directions, over none",
        "at most 6 times a plain simulation",
        lambda task, _: task.contenders[1].over(task.contenders[0]),
        6,
    ),
    Goal(
        "segments",
        "motion, exponent of cost over n_e",
        "linear: exponent of cost over n_e at most 1.1",
        lambda task, _: exponents(task)[0],
        1.1,
    ),
    Goal("data", "a data set of 177 s, in s", "in less than 1 s at the default step", lambda task, _: task.contenders[0].median, 1),
)

"""What a step of the controller would cost, were it written once, in CasADi: `python -m benchmarks.casadi_step` prints a table.

Filter, terminal cost, Hessian and gradient of `tepm_opt.control` as matrix expressions, on CasADi's virtual machine and as the C that
CasADi makes of them, and the tensions' program by CasADi's interface to DAQP. Linearisation, discretisation, devices and pressures would
come on top. Beside it stands the whole step as it is.
"""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import casadi as ca
import numpy as np
from casadi import MX

from benchmarks.control_loop import RecordedLoop, circle_with_approach
from tepm_opt.control.estimation.kalman_filter import Estimator
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.control.mpc.prediction import PredictionModel
from tepm_opt.control.mpc.state import OperatingPoints
from tepm_opt.models.compile import compile_model

MODES, ACTUATORS, OUTPUTS, STAGES = 10, 6, 12, 15
MOTION, FORCED = 2 * MODES, 2 * MODES + 4 * ACTUATORS
STATES, END, VARIABLES = FORCED + OUTPUTS, MOTION + ACTUATORS, STAGES * ACTUATORS
COMPILE = ("cc", "-O3", "-march=native", "-fno-math-errno", "-shared", "-fPIC", "-w")
ROUNDS, CALLS = 10, 200
DIFFERENCES = ca.DM(np.eye(VARIABLES) - np.eye(VARIABLES, k=-ACTUATORS))  # of the forces from stage to stage


def filter_functions() -> list[ca.Function]:
    """Prediction and correction of `Estimator`, the latter in a part without and one with the sample."""
    mean, P, push, noise = MX.sym("mean", STATES), MX.sym("P", STATES, STATES), MX.sym("push", STATES), MX.sym("noise", STATES, STATES)
    top, keeps = MX.sym("top", MOTION, FORCED), MX.sym("keeps", STATES - MOTION)
    A = ca.vertcat(ca.horzcat(top, MX(MOTION, OUTPUTS)), ca.horzcat(MX(STATES - MOTION, MOTION), ca.diag(keeps)))
    observe, points, sigma = MX.sym("observe", OUTPUTS, MODES), MX.sym("points", OUTPUTS), MX.sym("sigma")
    C, gain = ca.horzcat(observe, MX(OUTPUTS, FORCED - MODES), MX.eye(OUTPUTS)), MX.sym("gain", STATES, OUTPUTS)
    crossed, one = P @ C.T, MX.eye(STATES)
    K = ca.solve(ca.densify(C @ crossed) + sigma**2 * MX.eye(OUTPUTS), crossed.T, "ldl").T
    left = ca.densify(one) - K @ C
    return [
        ca.Function("predict", [mean, P, top, keeps, push, noise], [A @ mean + push, A @ P @ A.T + noise]),
        ca.Function("correct", [P, observe, sigma], [K, left @ P @ left.T + sigma**2 * (K @ K.T)]),
        ca.Function("update", [mean, gain, observe, points], [mean + gain @ (points - C @ mean)]),
    ]


def horizon_functions() -> list[ca.Function]:
    """The Riccati step of `CondensedOcp`, the Hessian and the gradient of `PredictionModel`."""
    value, A, Q = MX.sym("value", END, END), MX.sym("A", MOTION, MOTION), MX.sym("Q", MODES, MODES)
    start, end = MX.sym("start", MOTION, ACTUATORS), MX.sym("end", MOTION, ACTUATORS)
    turn, force, change = MX.sym("turn", MODES, MODES), MX.sym("force"), MX.sym("change")
    eye = MX.eye(ACTUATORS)
    full = ca.vertcat(ca.horzcat(A, start + end), ca.horzcat(MX(ACTUATORS, MOTION), eye))
    by, both = ca.vertcat(end, eye), ca.diagcat(turn, turn, eye)
    about = both @ value @ both.T
    forward = about @ full
    feedback = ca.solve(ca.densify(change * eye + by.T @ about @ by), by.T @ forward, "ldl")
    after = ca.diagcat(Q, MX(MODES, MODES), force * eye) + full.T @ (forward - about @ by @ feedback)
    return [
        ca.Function("riccati", [value, A, start, end, Q, turn, force, change], [(after + after.T) / 2]),
        ca.Function("condense", [value, A, start, end, Q, force, change], [_hessian(value, A, start, end, Q, force, change)]),
        _gradient(value, A, start, end, Q, force, change),
    ]


def _hessian(value: MX, A: MX, start: MX, end: MX, Q: MX, force: MX, change: MX) -> MX:
    """H: what a force does depends on how long ago it was alone, so that each row of blocks follows from the one below it."""
    later = [end, A @ end + start]
    for _ in range(2, STAGES):
        later.append(A @ later[-1])
    behind = [value[:MOTION, :MOTION] @ each for each in later]
    behind[0] = behind[0] + value[:MOTION, MOTION:]  # the last force is in the cost beyond
    ends = ca.horzcat(*behind[::-1])
    seen = ca.horzcat(*[Q @ each[:MODES, :] for each in later[-2::-1]], MX.zeros(MODES, ACTUATORS))
    rows, below = [], MX.zeros(ACTUATORS, 0)
    for stage in range(STAGES - 1, -1, -1):
        first, ago = stage * ACTUATORS, STAGES - 1 - stage
        below = ca.horzcat(below, MX.zeros(ACTUATORS, ACTUATORS))
        below = below + later[ago - 1][:MODES, :].T @ seen[:, first:] if ago else below
        row = below + later[ago].T @ ends[:, first:]
        if not ago:
            row = row + value[MOTION:, :MOTION] @ end + value[MOTION:, MOTION:]
        rows.append(ca.horzcat(MX(ACTUATORS, first), row))
    forced = ca.DM(np.diag(np.arange(VARIABLES) < VARIABLES - ACTUATORS).astype(float))
    upper = ca.densify(ca.vertcat(*rows[::-1]))
    return ca.triu2symm(ca.triu(upper)) + change * (DIFFERENCES.T @ DIFFERENCES) + force * forced


def _gradient(value: MX, A: MX, start: MX, end: MX, Q: MX, force: MX, change: MX) -> ca.Function:
    """The gradient where all deviations are 0: one sweep over the stages there, one back."""
    x, begin, rest, pushed = MX.sym("x", MOTION), MX.sym("begin", ACTUATORS), MX.sym("rest", MOTION), MX.sym("pushed", MOTION, STAGES)
    v, aim, cost = MX.sym("v", ACTUATORS, STAGES), MX.sym("aim", ACTUATORS), MX(0)
    inputs = [x, begin, rest, aim, pushed, value, A, start, end, Q, force, change]
    for k in range(STAGES):
        before = v[:, k - 1] if k else begin
        x = A @ x + start @ before + end @ v[:, k] + pushed[:, k]
        cost += change / 2 * ca.sumsqr(v[:, k] - before)
        if k < STAGES - 1:
            cost += ca.bilin(Q, x[:MODES] - rest[:MODES]) / 2 + force / 2 * ca.sumsqr(v[:, k] - aim)
    cost += ca.bilin(value, ca.vertcat(x - rest, v[:, -1] - aim)) / 2
    slope = ca.substitute(ca.gradient(cost, ca.vec(v)), v, MX.zeros(*v.shape))
    return ca.Function("gradient", inputs, [slope])


def tension_program() -> ca.Function:
    """The program of `TensionQp` by DAQP as CasADi calls it, which takes a new Hessian every time."""
    return ca.conic("program", "daqp", {"h": ca.Sparsity.dense(VARIABLES, VARIABLES), "a": DIFFERENCES.sparsity()})


class Case:
    """The controller's own objects half-way along the circle, their answers, and the arguments of the functions that give the same.

    Attributes:
        arguments, answers: of each function by its name.
    """

    def __init__(self) -> None:
        model = compile_model("kang2017")
        setup = Mpc(model, circle_with_approach(model, 1.0)).setup
        points, reference, weights, row = OperatingPoints(setup), setup.reference, setup.controller.weights, 500
        now, then = points.find(row), points.find(row + 1)
        estimator = Estimator(now, setup.noise, 3.5)
        for _ in range(5):
            estimator.predict(np.zeros((2, ACTUATORS)), np.full(ACTUATORS, 3.0), np.full(ACTUATORS, 0.01), now)
            estimator.update(now.model.equilibrium.points + 1e-4)
        mean, P = estimator.mean, estimator.covariance
        done = estimator.predict(reference.forces[[row, row + 1]], np.full(ACTUATORS, 3.0), np.full(ACTUATORS, 0.01), then)
        moved, spread = estimator.mean, estimator.covariance
        seen = estimator.estimate(np.zeros(0)).points + 2e-4
        estimator.update(seen)
        gain, off = estimator.correction.gain, (seen - then.model.equilibrium.points).ravel()
        forecast, rows = PredictionModel(weights, STAGES), row + 2 * np.arange(-1, STAGES + 2)
        forecast.prepare(now, reference, rows)
        before, turn = forecast.horizon.value, then.seen_from(now)[0]
        hessian = forecast.prepare(then, reference, rows + 1)
        horizon = forecast.horizon
        Q, force, change = horizon.rows().T @ horizon.rows(), weights.force**-2, weights.change**-2
        begin = np.linspace(-0.2, 0.3, ACTUATORS)
        horizon.set_initial_state(np.linspace(-0.01, 0.01, MOTION), np.array([1e-3, -2e-3, 1e-3]))
        slope = forecast.gradient(begin)
        own = [horizon.value, horizon.stage.A, horizon.by_start, horizon.by_end, Q, force, change]
        start = [horizon.free[0], begin, horizon.rest, horizon.rest_force, horizon._pushed]
        A, observe = done.A, then.model.observe
        self.arguments = {
            "predict": [mean, P, A[:MOTION, :FORCED], np.diag(A)[MOTION:], done.push, done.kick @ done.kick.T],
            "correct": [spread, observe, estimator.noise], "update": [moved, gain, observe, off],
            "riccati": [before, *own[1:5], turn, force, change], "condense": own, "gradient": [*start, *own],
        }  # fmt: skip
        self.answers = {
            "predict": [moved, spread], "correct": [gain, estimator.covariance], "update": [estimator.mean],
            "riccati": [horizon.value], "condense": [hessian], "gradient": [slope],
        }  # fmt: skip


def prepare_call(function: ca.Function, values: list[Any]) -> tuple[Callable[[], None], list[np.ndarray]]:
    """A call of a function on fixed arguments without conversions, and its results, column by column."""
    buffer, run = function.buffer()
    held = [np.asarray(value, dtype=float).ravel(order="F").copy() for value in values]
    found = [np.zeros(function.nnz_out(k)) for k in range(function.n_out())]
    for k, array in enumerate(held):
        buffer.set_arg(k, memoryview(array))
    for k, array in enumerate(found):
        buffer.set_res(k, memoryview(array))
    return lambda _=(buffer, held, found): run(), found  # CasADi keeps addresses alone


def least_time(call: Callable[[], object], calls: int = CALLS) -> float:
    """Time of a call in µs, the least of some rounds."""
    times = []
    for _ in range(ROUNDS):
        began = time.perf_counter()
        for _ in range(calls):
            call()
        times.append((time.perf_counter() - began) / calls)
    return 1e6 * min(times)


def compile_functions(functions: list[ca.Function], folder: Path) -> tuple[dict[str, ca.Function], str]:
    """The functions as C, and how long that took and how large it is."""
    generator = ca.CodeGenerator("step.c")
    for function in functions:
        generator.add(function)
    generator.generate(f"{folder}/")
    began, library = time.perf_counter(), folder / "step.so"
    subprocess.run([*COMPILE, str(folder / "step.c"), "-o", str(library), "-lm"], check=True)
    told = f"compiled in {time.perf_counter() - began:.1f} s, {library.stat().st_size / 1024:.0f} kB"
    return {each.name(): ca.external(each.name(), str(library)) for each in functions}, told


def main() -> None:
    """Print the table."""
    case, functions, sums = Case(), [*filter_functions(), *horizon_functions()], np.zeros(2)
    with TemporaryDirectory() as folder:
        compiled, told = compile_functions(functions, Path(folder))
        print(f"{'':10} {'virtual machine':>16} {'C':>8}  µs ({told})")
        for function in functions:
            both = [least_time(prepare_call(one, case.arguments[function.name()])[0]) for one in (function, compiled[function.name()])]
            sums += both
            print(f"{function.name():10} {both[0]:16.1f} {both[1]:8.1f}")
    print(f"{'sum':10} {sums[0]:16.1f} {sums[1]:8.1f}")
    program, hessian = tension_program(), case.answers["condense"][0]
    bounds = {"lbx": -1.0, "ubx": 1.0, "lba": -0.2, "uba": 0.2}
    given = {"h": hessian, "g": case.answers["gradient"][0], "a": np.array(DIFFERENCES.nonzeros())}
    values = [given.get(name, np.full(program.size_in(name), bounds.get(name, 0.0))) for name in program.name_in()]
    print(f"{'program':10} {least_time(prepare_call(program, values)[0], 20):16.1f}")
    loop = RecordedLoop(compile_model("kang2017"))
    for name, call, ready in (
        ("whole step as it is", loop.whole, loop.begin),
        ("of it from sample to command", loop.feedback, loop.prepare),
    ):
        took = []
        for _ in range(500):
            ready()
            began = time.perf_counter()
            call()
            took.append(time.perf_counter() - began)
        print(f"{name}: {1e6 * np.median(took):.0f} µs, in {'C' if loop.is_c else 'Python'}")


if __name__ == "__main__":
    main()

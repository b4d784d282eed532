"""Quadratic programs beside another solver's answer or their optimality conditions; whatever fails says so."""

import numpy as np
import pytest
from scipy.optimize import minimize

from tepm_opt.control.mpc.qp import QpSolver
from tepm_opt.errors import InputError
from tepm_opt.outcome import Ending

FORCES, STAGES = 6, 15
SIZE = FORCES * STAGES
RATE, HIGHEST = 0.2, 7.0  # N
RATES = np.eye(SIZE) - np.eye(SIZE, k=-FORCES)


def optimality(result, H, f, low, high, rows):
    """Largest violation of the optimality conditions, relative to f: gradient of the Lagrangian, signs, complementary slackness."""
    n = len(f)
    at = np.concatenate([result.x, rows @ result.x])
    force = result.multipliers
    gradient = H @ result.x + f + force[:n] + rows.T @ force[n:]
    scale = abs(f).max() + abs(H @ result.x).max()
    pushed_down, pushed_up = force > 1e-9 * scale, force < -1e-9 * scale
    slack = max(np.abs((high - at)[pushed_down]).max(initial=0), np.abs((at - low)[pushed_up]).max(initial=0))
    return max(abs(gradient).max() / scale, slack, (low - at).max(), (at - high).max())


def solve(solver, program):
    H, f, low, high, _ = program
    n = len(f)
    return solver.solve(H, f, low[:n], high[:n], low[n:], high[n:])


class Programs:
    """Random programs of the controller's shape, cheaply: Hessians of a few random responses, scaled by random amounts."""

    def __init__(self, seed):
        self.random = np.random.default_rng(seed)
        self.hessians = []
        for _ in range(20):
            swing, fade = self.random.uniform(0.1, 1.0, 8), self.random.uniform(0.8, 0.99, 8)
            by = self.random.normal(size=(8, FORCES))
            impulse = (fade ** np.arange(STAGES)[:, None] * np.sin(swing * np.arange(1, STAGES + 1)[:, None]))[..., None] * by
            response = np.zeros((STAGES, 8, STAGES, FORCES))
            for stage in range(STAGES):
                response[stage:, :, stage] = impulse[: STAGES - stage]
            flat = response.reshape(STAGES * 8, SIZE)
            smooth = RATES.T @ RATES
            self.hessians.append(flat.T @ flat + self.random.uniform(0.01, 1) * smooth + 0.01 * np.eye(SIZE))

    def make(self, feasible=True):
        """H, f, low, high of x and of the rates, and these rows; the best without bounds is often far outside them."""
        random = self.random
        scale = 10 ** random.uniform(-3, 3)
        H = scale * self.hessians[random.integers(len(self.hessians))]
        before = random.uniform(0, HIGHEST, FORCES)
        far = 1.0 if random.random() < 0.05 else 0.03
        ramp = np.linspace(0.1, 1, STAGES)[:, None] * random.normal(scale=20 * far, size=FORCES)
        f = -H @ (np.tile(before, STAGES) + ramp.ravel() + random.normal(scale=far, size=SIZE))
        low, high = np.concatenate([np.zeros(SIZE), np.full(SIZE, -RATE)]), np.concatenate([np.full(SIZE, HIGHEST), np.full(SIZE, RATE)])
        low[SIZE : SIZE + FORCES] += before
        high[SIZE : SIZE + FORCES] += before
        if not feasible:
            kind, which = random.integers(3), random.integers(FORCES)
            if kind == 0:  # the tension before is out of reach
                for side in (low, high):
                    side[SIZE + which] += HIGHEST + 2 * RATE + 0.01 - before[which]
            elif kind == 1:  # a later tension is
                stage = int(random.integers(1, STAGES - 1))
                there = before[which] + (stage + 1.1) * RATE * (1 if before[which] < HIGHEST / 2 else -1)
                low[stage * FORCES + which] = high[stage * FORCES + which] = there
            else:
                low[which], high[which] = 5.0, 4.0
        return H, f, low, high, RATES


def small(random, rows=5):
    """Six variables and random rows, most of them in the way."""
    root, R = random.normal(size=(6, 6)), random.normal(size=(rows, 6))
    low, high = np.concatenate([np.full(6, -1.0), np.full(rows, -0.5)]), np.concatenate([np.full(6, 1.0), np.full(rows, 0.8)])
    return root @ root.T + 0.1 * np.eye(6), 5 * random.normal(size=6), low, high, R


def slsqp(H, f, low, high, R):
    """The answer of SciPy's SLSQP."""
    rows = [{"type": "ineq", "fun": lambda x: high[6:] - R @ x}, {"type": "ineq", "fun": lambda x: R @ x - low[6:]}]
    bounds, settings = list(zip(low[:6], high[:6], strict=True)), {"ftol": 1e-14, "maxiter": 500}
    cost, slope = lambda x: x @ H @ x / 2 + f @ x, lambda x: H @ x + f
    return minimize(cost, np.zeros(6), jac=slope, method="SLSQP", bounds=bounds, constraints=rows, options=settings).x


def test_another_solver():
    """SLSQP, Kraft 1988, finds the same."""
    random = np.random.default_rng(2)
    for _ in range(20):
        program = small(random)
        found, expected = solve(QpSolver(program[-1]), program), slsqp(*program)
        np.testing.assert_allclose(found.x, expected, atol=1e-5)
        assert optimality(found, *program) < 1e-8
        assert found.solved
        assert 0 < found.seconds < 1
        assert found.iterations > 0


@pytest.mark.parametrize("count", [500, pytest.param(10_000, marks=pytest.mark.slow)])
def test_thousands_of_programs(count):
    """Every twentieth has no solution; every answer is checked by its optimality conditions."""
    programs, solver, worst = Programs(0), QpSolver(RATES), 0.0
    for k in range(count):
        feasible = k % 20 != 7
        program = programs.make(feasible)
        result = solve(solver, program)
        assert result.outcome.ending is (Ending.SOLVED if feasible else Ending.INFEASIBLE), k
        assert (result.x is None) != feasible
        if feasible:
            worst = max(worst, optimality(result, *program))
    assert worst < 1e-6


def test_warm_start():
    """The program of the next period is near: little is left to do, and the answer is the one from a new solver."""
    programs, warm, counts = Programs(3), QpSolver(RATES), []
    for _ in range(10):
        H, f, low, high, rows = programs.make()
        for drift in (0.0, 0.001, 0.002):
            program = H * (1 + drift), f * (1 - drift), low, high, rows
            found, expected = solve(warm, program), solve(QpSolver(RATES), program)
            np.testing.assert_allclose(found.x, expected.x, atol=1e-7)
            counts += [(found.iterations, expected.iterations)] if drift else []
    again, anew = np.sum(counts, axis=0)
    assert again < anew / 2


def test_the_same_hessian():
    """May be left out, also after a failure; not where there was none of use."""
    programs = Programs(10)
    solver, (H, f, low, high, _) = QpSolver(RATES), programs.make()
    assert solve(solver, (None, f, low, high, None)).outcome.ending is Ending.FAILED
    solve(solver, (H, f, low, high, None))
    for k in range(6):
        g = f * (1 + 0.01 * k)
        if k == 3:
            assert solve(solver, spoiled((H, g, low, high, RATES), "out of reach")).outcome.ending is Ending.INFEASIBLE
        found, expected = solve(solver, (None, g, low, high, None)), solve(QpSolver(RATES), (H, g, low, high, None))
        np.testing.assert_allclose(found.x, expected.x, atol=1e-9)
        np.testing.assert_allclose(found.multipliers, expected.multipliers, atol=1e-6 * abs(f).max())
    assert solve(solver, spoiled((H, f, low, high, RATES), "matrix")).outcome.ending is Ending.NOT_FINITE
    assert solve(solver, (None, f, low, high, None)).outcome.ending is Ending.FAILED


def test_degenerate_rows():
    """Rows that repeat each other and the bounds, that are zero, and that leave no room at all."""
    random = np.random.default_rng(4)
    solvers = {}
    for k in range(60):
        H, f, low, high, R = small(random, 3)
        kind = k % 4
        if kind == 0:
            R, low, high = np.vstack([R, R, 2 * R]), np.r_[low, low[6:], 2 * low[6:]], np.r_[high, high[6:], 2 * high[6:]]
        elif kind == 1:
            R, low, high = np.vstack([np.eye(6), R]), np.r_[low[:6], low], np.r_[high[:6], high]
        elif kind == 2:
            R, low, high = np.vstack([R, 0 * R]), np.r_[low, -1, 0, 0], np.r_[high, 1, 0, 1]
        else:
            low[7:9] = high[7:9] = 0.25
        solvers[kind] = QpSolver(R)
        for _ in range(2):
            program = H, f, low, high, R
            assert optimality(solve(solvers[kind], program), *program) < 1e-7


def test_bounds_may_be_infinite():
    H, f, low, high, R = small(np.random.default_rng(5))
    nothing = np.full(11, np.inf)
    np.testing.assert_allclose(solve(QpSolver(R), (H, f, -nothing, nothing, R)).x, -np.linalg.solve(H, f), rtol=1e-9)
    without_rows = solve(QpSolver(np.zeros((0, 6))), (H, f, low[:6], high[:6], R[:0]))
    assert optimality(without_rows, H, f, low[:6], high[:6], R[:0]) < 1e-9


def spoiled(program, what):
    """A program without an answer."""
    H, f, low, high, R = (np.array(part) for part in program)
    n = len(f)
    if what == "matrix":
        H[n // 2, 0] = np.nan
    elif what == "vector":
        f[-1] = np.inf
    elif what == "bound":
        low[3] = np.nan
    elif what == "row":
        high[-2] = np.nan
    elif what == "crossed":
        low[n], high[n] = 1.0, 0.5
    elif what == "out of reach":
        low[n:] = high[n:] = 1e3
    elif what == "no number":
        low[0] = np.inf
    else:
        H = -H
    return H, f, low, high, R


@pytest.mark.parametrize(
    ("what", "ending"),
    [
        ("matrix", Ending.NOT_FINITE), ("vector", Ending.NOT_FINITE), ("bound", Ending.NOT_FINITE), ("row", Ending.NOT_FINITE),
        ("crossed", Ending.INFEASIBLE), ("out of reach", Ending.INFEASIBLE), ("no number", Ending.INFEASIBLE),
        ("concave", Ending.NOT_CONVEX),
    ],
)  # fmt: skip
def test_failures_are_flagged_and_pass(what, ending):
    """Before and after, cold and warm, the good program has its answer."""
    good = Programs(6).make()
    expected = solve(QpSolver(RATES), good).x
    solver = QpSolver(RATES)
    for _ in range(2):
        failed = solve(solver, spoiled(good, what))
        assert failed.outcome.ending is ending
        assert failed.x is None
        assert failed.multipliers is None
        assert not failed.solved
        for _ in range(2):
            np.testing.assert_allclose(solve(solver, good).x, expected, atol=1e-9)


def test_too_many_iterations():
    programs = Programs(7)
    program = next(one for one in iter(programs.make, None) if solve(QpSolver(RATES), one).iterations > 20)
    solver = QpSolver(RATES, iterations=5)
    for _ in range(2):
        failed = solve(solver, program)
        assert failed.outcome.ending is Ending.ITERATION_LIMIT
        assert failed.x is None


def test_singular_hessian():
    """Directions without cost of their own: the answer is one of the best."""
    random, worst = np.random.default_rng(8), 0.0
    for rank in (1, 2, 3, 4, 5) * 20:
        _, _, low, high, R = small(random)
        root = random.normal(size=(6, rank))
        H, f = root @ root.T, root @ random.normal(size=rank)
        program = H, f, low, high, R
        found = solve(QpSolver(R), program)
        assert found.solved
        worst = max(worst, optimality(found, *program))
    assert worst < 1e-6


def test_soft_rows():
    """As with a slack for each row, squared in the cost; bounds stay hard; what no slack can mend is reported."""
    random, weight = np.random.default_rng(9), 30.0
    for _ in range(10):
        H, f, low, high, R = small(random)
        slack = solve(
            QpSolver(np.hstack([R, np.eye(5)])),
            (np.block([[H, np.zeros((6, 5))], [np.zeros((5, 6)), weight * np.eye(5)]]), np.r_[f, np.zeros(5)],
             np.r_[low[:6], np.full(5, -np.inf), low[6:]], np.r_[high[:6], np.full(5, np.inf), high[6:]], None),
        )  # fmt: skip
        found = solve(QpSolver(R, soft=weight), (H, f, low, high, R))
        np.testing.assert_allclose(found.x, slack.x[:6], atol=1e-6)
        assert found.violation == pytest.approx(max((R @ found.x - high[6:]).max(), (low[6:] - R @ found.x).max(), 0), abs=1e-12)
    out_of_reach = spoiled((H, f, low, high, R), "out of reach")
    found = solve(QpSolver(R, soft=weight), out_of_reach)
    assert found.solved
    assert found.violation > 900
    assert (abs(found.x) <= 1).all()


def test_wrong_input():
    H, f, low, high, R = small(np.random.default_rng(0))
    with pytest.raises(InputError, match="shapes"):
        QpSolver(R).solve(H, f[:-1], low[:6], high[:6], low[6:], high[6:])
    with pytest.raises(InputError, match="rows"):
        QpSolver(np.full((2, 3), np.nan))
    with pytest.raises(InputError, match="weight"):
        QpSolver(R, soft=0.0)

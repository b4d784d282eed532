"""The same answer compiled or not: statics.py is the reference for statics.c, kinematics.py for kinematics.c."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.models.backends import compiler as compiling
from tepm_opt.models.backends.ccode import FLAGS
from tepm_opt.models.backends.interface import Allotment, InverseNewton, InverseProblem, LoadCase, Status
from tepm_opt.models.compile import compile_model
from tepm_opt.models.model import Model
from tests.tools import random_directions, random_inputs, relative, variant, with_all_effects

MODELS = {
    "kang2017": lambda: Model.from_robot("kang2017"),
    "one module of four actuators": lambda: Model.from_robot(
        variant(geometry={"modules": 1, "segments_per_module": 5, "actuator_angles_deg": (0.0, 90.0, 180.0, 270.0)})
    ),
    "one segment of five uneven actuators": lambda: Model.from_robot(
        variant(geometry={"modules": 1, "segments_per_module": 1, "actuator_angles_deg": (0.0, 60.0, 150.0, 200.0, 300.0)})
    ),
    "all effects": lambda: with_all_effects(Model.from_robot("kang2017")),
}


FAST = ("kang2017", "all effects")


@pytest.fixture(scope="module", params=[pytest.param(name, marks=() if name in FAST else pytest.mark.slow) for name in MODELS])
def pair(request, compiler):
    """A model in C and in Python."""
    model = MODELS[request.param]()
    compiled = compile_model(model, backend="c")
    assert compiled.is_c
    return compiled, compile_model(model, backend="python")


def cases(model, count):
    forces = np.zeros((count, 3 * model.layout.points))
    forces[:, -3:] = random_directions(count, 1) * np.linspace(0, 1, count)[:, None]
    part = 1.0 if model.layout.segments > 1 else 0.3  # a single segment twists under more
    return zip(random_inputs(model, count, 2, 0, part), forces, strict=True)


def test_actuation(pair):
    c, python = pair
    for u, _ in cases(c, 5):
        np.testing.assert_allclose(c.statics.actuation(u, c.theta), python.statics.actuation(u, c.theta), rtol=1e-15)


@pytest.mark.parametrize("mapped", [False, True])
def test_statics(pair, mapped):
    c, python = pair
    for u, external in cases(c, 6):
        found, expected = (m.statics.statics(c.rest, LoadCase(u, mapped, external, c.theta), 1e-9, 100) for m in (c, python))
        assert found.status == expected.status == Status.SOLVED
        assert abs(found.x - expected.x).max() < 1e-9
        assert abs(found.observed - expected.observed).max() < 1e-9
        assert found.energy == pytest.approx(expected.energy, rel=1e-10)
        assert found.iterations == expected.iterations
        assert max(found.residual, expected.residual) < 1e-9


@pytest.mark.parametrize("mapped", [False, True])
def test_sensitivities(pair, mapped):
    c, python = pair
    observations = 3 * c.layout.points + c.layout.inputs // 2
    weights = np.random.default_rng(0).normal(size=(5, observations))
    for u, external in cases(c, 3):
        x = python.statics.statics(c.rest, LoadCase(u, mapped, external, c.theta), 1e-9, 100).x
        found, expected = (m.statics.sensitivity(x, LoadCase(u, mapped, external, c.theta), weights, True) for m in (c, python))
        assert found[0] == expected[0] == Status.SOLVED
        half = c.layout.inputs // 2
        blocks = [(found[1][:, :half], expected[1][:, :half]), (found[1][:, half:], expected[1][:, half:]), (found[2], expected[2])]
        blocks += [(found[3][:, [k]], expected[3][:, [k]]) for k in range(len(c.theta)) if expected[3][:, k].any()]
        assert all(relative(*block) < 1e-8 for block in blocks)
        for model in pair:  # without the parameters' kernels run that do less
            _, by_u, by_external, by_theta = model.statics.sensitivity(x, LoadCase(u, mapped, external, c.theta), weights, False)
            assert by_theta is None
            assert max(relative(by_u, expected[1]), relative(by_external, expected[2])) < 1e-8


@pytest.mark.parametrize("mapped", [False, True])
def test_matrices(pair, mapped):
    """Stiffness and damping at an equilibrium and elsewhere."""
    c, python = pair
    for u, external in cases(c, 4):
        x = python.statics.statics(c.rest, LoadCase(u, mapped, external, c.theta), 1e-9, 100).x
        for levels in (x, c.rest):
            found, expected = (m.statics.matrices(levels, LoadCase(u, mapped, external, c.theta)) for m in (c, python))
            assert [matrix.shape for matrix in found] == 2 * [(2 * c.layout.block, c.layout.levels * c.layout.block)]
            assert max(relative(*both) for both in zip(found, expected, strict=True)) < 1e-12


def test_inverse(pair):
    """Levels and pressures at which as many sums of observations as actuators have their targets, from a start nearby."""
    c, python = pair
    half, observations = c.layout.inputs // 2, 3 * c.layout.points + c.layout.inputs // 2
    weights = np.eye(observations)[-half:]  # the actuators' lengths
    for u, external in cases(c, 3):
        p = u[:half] / 2
        start, goal = (
            python.statics.statics(c.rest, LoadCase(np.append(q, 0 * q), True, external, c.theta), 1e-9, 100) for q in (p, p + 5e3)
        )
        newton, case = InverseNewton(1e5, 1e-10, 1e-9, 30), LoadCase(np.append(p, 0 * p), True, external, c.theta)
        arguments = (start.x, case, weights, weights @ goal.observed)
        found, expected = (m.statics.inverse(*arguments, newton) for m in (c, python))
        assert found[0] == expected[0] == Status.SOLVED
        assert found[3] == expected[3]
        assert abs(found[1] - expected[1]).max() < 1e-9
        np.testing.assert_allclose(found[2], expected[2], rtol=1e-9)
        np.testing.assert_allclose(found[2], p + 5e3, rtol=1e-6)
        assert abs(found[1] - goal.x).max() < 1e-7
        too_few = [m.statics.inverse(*arguments, replace(newton, max_iterations=1)) for m in (c, python)]
        assert too_few[0][0] == too_few[1][0] != Status.SOLVED


def test_response(pair):
    """Statics and sensitivities in one call; no derivatives where there is no equilibrium."""
    c, python = pair
    weights = np.random.default_rng(0).normal(size=(5, 3 * c.layout.points + c.layout.inputs // 2))
    for u, external in cases(c, 3):
        found, expected = (m.statics.response(c.rest, LoadCase(u, True, external, c.theta), weights, 1e-9, 100) for m in (c, python))
        assert found[0] == expected[0] == Status.SOLVED
        assert max(abs(found[k] - expected[k]).max() for k in (1, 2)) < 1e-9
        assert relative(found[3], expected[3]) < 1e-8
        by_u = c.statics.sensitivity(found[1], LoadCase(u, True, external, c.theta), weights, False)[1]
        assert relative(found[3], by_u) < 1e-8
        case = LoadCase(3 * u, True, external, c.theta)
        assert [m.statics.response(c.rest, case, weights, 1e-9, 0)[0] for m in (c, python)] == 2 * [Status.EXHAUSTED]


def allotments(model):
    """Pressure alone, and pressure on its grid with tension."""
    half, limit = model.layout.inputs // 2, model.input_max
    tension = np.where(np.arange(2 * half) < half, 0.0, limit / 2)
    return [Allotment(model.values["A"], start, limit, model.input_step, fine) for start, fine in ((0 * limit, False), (tension, True))]


def test_allocate(pair):
    """Forces within the limits, beyond them, and on actuators whose grids are fine, coarse or none."""
    c, python = pair
    half = c.layout.inputs // 2
    for size, seed in ((1e-3, 2), (10.0, 0), (40.0, 1)):  # the first ones a dead zone swallows for long
        for forces in np.random.default_rng(seed).uniform(-0.3 * size, size, (6, half)):
            for by in (*allotments(c), replace(allotments(c)[1], grid=np.where(np.arange(2 * half) % 2, 0.0, c.input_step))):
                found, expected = (m.statics.allocate(forces, by, c.theta) for m in (c, python))
                np.testing.assert_allclose(found[0], expected[0], rtol=1e-9, atol=1e-9)
                np.testing.assert_allclose(found[1], expected[1], rtol=1e-9, atol=1e-9)
                assert found[2] == pytest.approx(expected[2], abs=1e-9)
                assert size > 10 or found[2] < 20


@pytest.mark.parametrize("cold", [False, True])
def test_configurations(pair, cold):
    """From the goals before: the forces that were there, and inputs that make them; and why it ends where it does."""
    c, python = pair
    half, observations, area = c.layout.inputs // 2, 3 * c.layout.points + c.layout.inputs // 2, c.values["A"]
    lengths, by = np.eye(observations)[-half:], allotments(c)[1]
    u, external = list(cases(c, 3))[1]
    p = u[:half] / 2
    start, goal = (python.statics.statics(c.rest, LoadCase(np.append(q, 0 * q), True, external, c.theta), 1e-9, 100) for q in (p, p + 5e3))
    weights = lengths - np.outer(np.where(np.arange(half) < 3, 0.0, lengths @ goal.observed / (lengths[0] @ goal.observed)), lengths[0])
    problem = InverseProblem(external, c.theta, weights, np.full(half, -7.0), np.full(half, 25.0), 0.02, by, 1e5 * area, 1e-10, 1e-9, 30)
    targets, actuation = np.array(2 * [(lengths @ goal.observed)[:3]]), np.append(p, 0 * p)

    def both(problem, targets=targets):
        return [m.statics.configurations(problem, targets, c.rest if cold else start.x, actuation, cold) for m in (c, python)]

    (found, full), ((expected,), one) = both(problem)
    assert full == one == Status.SOLVED
    assert [pose.steps for pose in found] == [expected.steps, 0]
    for pose in found:
        for got, wanted in zip(pose[:5], expected[:5], strict=True):
            np.testing.assert_allclose(got, wanted, rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(pose.actuation[:half], p + 5e3, rtol=1e-6)
        assert pose.room == pytest.approx(expected.room, rel=1e-9)
        assert max(pose.residual, expected.residual) < 1e-9
        assert pose.missed == pytest.approx(expected.missed, abs=1e-9)
        made = c.statics.actuation(pose.inputs, c.theta)
        np.testing.assert_allclose(area * made[:half] - made[half:], area * pose.actuation[:half], atol=pose.missed + 1e-9)

    highest = (area * p).max() + 1e-3  # 5 kPa more is 0.25 N
    assert both(replace(problem, high=np.full(half, highest))) == 2 * [([], Status.BEYOND)]
    assert both(replace(problem, shortest=goal.observed[-half:].max())) == 2 * [([], Status.STALLED)]
    assert both(replace(problem, max_iterations=1)) == 2 * [([], Status.EXHAUSTED)]
    far = np.array([targets[0], targets[1] + 5.0])
    first, second = both(problem, far)
    assert len(first[0]) == len(second[0]) == 1
    assert first[1] not in (Status.SOLVED, Status.BEYOND)


def test_failures_have_the_same_status(kang, kang_python, compiler):
    """3 N straight down: the straight robot is a saddle; 1 iteration: not enough."""
    external = np.array([0] * 11 + [-3.0])
    for most, status in ((100, Status.UNSTABLE), (1, Status.EXHAUSTED)):
        found = [m.statics.statics(kang.rest, LoadCase(np.zeros(12), False, external, kang.theta), 1e-9, most) for m in (kang, kang_python)]
        assert [solution.status for solution in found] == [status, status]
    x = found[0].x
    results = [m.statics.sensitivity(x, LoadCase(np.zeros(12), False, external, kang.theta), np.eye(18), True) for m in (kang, kang_python)]
    assert results[0][0] == results[1][0] == 4


def test_threads_do_not_disturb_each_other(kang, compiler):
    """Every thread has arrays of its own; ctypes releases the interpreter's lock while C runs."""

    def solve(u):
        return kang.statics.statics(kang.rest, LoadCase(u, False, np.zeros(12), kang.theta), 1e-9, 100).observed

    inputs = random_inputs(kang, 200, 3)
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(solve, inputs))
    np.testing.assert_array_equal(together, [solve(u) for u in inputs])


@pytest.mark.parametrize(("variable", "last"), [(None, FLAGS[-1]), ("-O1 -g", "-g")])
def test_flags_of_the_environment_come_last(
    compiler: None, empty_cache: Path, monkeypatch: pytest.MonkeyPatch, variable: str | None, last: str
) -> None:
    monkeypatch.delenv(compiling.FLAGS_VARIABLE, raising=False)
    if variable:
        monkeypatch.setenv(compiling.FLAGS_VARIABLE, variable)
    used: list[str] = []
    compile_text = compiling._compile
    monkeypatch.setattr(compiling, "_compile", lambda command, text, flags: used.extend(flags) or compile_text(command, text, flags))
    assert (
        compiling.build([compiling.Part("answer", "int answer(void) { return 42; }", FLAGS)], "answer", ("answer",), "nothing") is not None
    )
    assert used[: len(FLAGS)] == list(FLAGS)
    assert used[-1] == last

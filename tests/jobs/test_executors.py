"""Sweeps: the same results wherever they run; what is done when the user interrupts is kept."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tepm_opt.jobs.executors import processes, sweep
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.identification.identify import Problem
from tepm_opt.solvers.identification.uncertainty import multi_start
from tepm_opt.solvers.linear.gain import workspace_map
from tepm_opt.solvers.mechanics.network_plant import NetworkPlant, free_parameters
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.solvers.numerics.parallel import cores
from tests.data.made import make_dataset


class Pickling(Executor):
    """An executor that hands over what another process would get."""

    def submit(self, work: Callable[..., Any], /, *given: Any, **named: Any) -> Future[Any]:
        work, given = pickle.loads(pickle.dumps((work, given)))
        future: Future[Any] = Future()
        future.set_result(pickle.loads(pickle.dumps(work(*given))))
        return future


def squared(number: int) -> tuple[int, int]:
    """A square, and the cores that its work may use."""
    return number**2, cores()


def interrupted(number: int) -> int:
    """A number; 2 ends everything."""
    if number == 2:
        raise KeyboardInterrupt
    return number


def test_results_are_in_the_order_of_the_items() -> None:
    told: list[tuple[float, float]] = []
    expected = [(number**2, 1) for number in range(5)]
    assert sweep(squared, range(5), jobs=1, progress=lambda stage, done, of: told.append((done, of))) == (expected, False)
    assert told[-1] == (5, 5)
    with ThreadPoolExecutor(3) as executor:
        assert sweep(squared, range(5), executor) == (expected, False)


@pytest.mark.slow
def test_processes_of_this_machine() -> None:
    with processes(2) as executor:
        assert sweep(squared, range(5), executor) == ([(number**2, 1) for number in range(5)], False)
    assert sweep(squared, range(3), jobs=2)[0] == [(0, 1), (1, 1), (4, 1)]


def test_what_is_done_is_kept() -> None:
    assert sweep(interrupted, range(5), jobs=1) == ([0, 1], True)


def test_an_error_ends_it_and_takes_back_what_waits() -> None:
    begun: list[int] = []

    def work(number: int) -> float:
        begun.append(number)
        return 1 / (number - 1)

    with ThreadPoolExecutor(1) as executor, pytest.raises(ZeroDivisionError):
        sweep(work, range(50), executor)
    assert len(begun) < 50


def test_a_compiled_model_is_compiled_where_it_is_read(kang: CompiledModel) -> None:
    """Once a process, with the values it has."""
    changed = kang.with_theta(1.01 * kang.theta)
    first, second = (pickle.loads(pickle.dumps(model)) for model in (kang, changed))
    assert first.network is second.network
    np.testing.assert_array_equal(second.theta, changed.theta)
    inputs = 0.1 * kang.input_max
    np.testing.assert_array_equal(solve_statics(second, inputs).x, solve_statics(changed, inputs).x)


def test_the_map_of_g_anywhere(kang: CompiledModel) -> None:
    grid = np.linspace(-0.2, 0.2, 3), np.array([0.3, 0.4])
    here, there = workspace_map(kang, *grid), workspace_map(kang, *grid, executor=Pickling())
    assert here.reached.any()
    np.testing.assert_array_equal(there.values(lambda gain: gain.condition()), here.values(lambda gain: gain.condition()))


def _few(kang: CompiledModel) -> Iterator[Any]:
    for run in make_dataset().fit[:1]:
        yield replace(run, time=run.time[:40], inputs=run.inputs[:40], tip_force=run.tip_force[:40], points=run.points[:40])


def test_fits_from_several_starts_anywhere(kang: CompiledModel) -> None:
    runs = tuple(_few(kang))
    problem = Problem(NetworkPlant(kang), runs, free_parameters(kang, ["c_a"]), (3e-4,) * len(runs), False, 0.02)
    here, there = (multi_start(problem, 2, 3, 3, executor=executor) for executor in (None, Pickling()))
    np.testing.assert_allclose(there.values, here.values, rtol=1e-9)
    assert there.problem is problem

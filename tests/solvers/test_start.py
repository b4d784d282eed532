"""States that runs begin with: found from what they measured, and free ones taken out of the fit as a joint fit would have them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from tepm_opt.data.run import Run, Start
from tepm_opt.discrepancy.adapters.casadi_plant import CasadiPlant
from tepm_opt.discrepancy.adapters.equations import Equations
from tepm_opt.solvers.identification.identify import Problem, identify
from tepm_opt.solvers.identification.initial_state import first, predictions, with_estimated_initial_state, without_start
from tepm_opt.solvers.identification.residuals import Residual
from tepm_opt.solvers.mechanics.plant import START

NOISE = 1e-3
TIME = np.arange(0, 2.0, 0.01)


@pytest.fixture(scope="module")
def plant() -> CasadiPlant:
    """A mass on a spring that hardens."""
    m = Equations("a mass on a spring", laws=())
    q, v = m.state("q"), m.state("v")
    force = m.input("force", size=1.0)
    spring, damping = m.parameter("spring", 20.0, "N/m", within=0.5), m.parameter("damping", 1.0, "N s/m", within=0.9)
    m.rate(q, v)
    m.rate(v, force - spring * (q + 4 * q**3) - damping * v)
    m.output("position", q, "m")
    return m.plant()


def force(time: np.ndarray | float) -> np.ndarray:
    """What drives it, in N."""
    return 2.0 * np.sin(3.0 * np.asarray(time))


def swing(state: tuple[float, float], start: Start, seed: int = 1, spring: float = 24.0, damping: float = 0.7) -> Run:
    """A noisy run from a state, by another integrator."""
    motion = solve_ivp(
        lambda t, x: [x[1], force(t) - spring * (x[0] + 4 * x[0] ** 3) - damping * x[1]], TIME[[0, -1]], state, "DOP853", TIME, rtol=1e-10
    )
    points = motion.y[0] + np.random.default_rng(seed).normal(0, NOISE, len(TIME))
    return Run(f"{seed}.csv", "fit", TIME, force(TIME)[:, None], np.zeros((len(TIME), 3)), points[:, None, None], start=start)


def joint(plant: CasadiPlant, runs: list[Run], names: list[str]) -> np.ndarray:
    """Parameters and states of all runs in one fit, by SciPy with differences."""

    def left(values: np.ndarray) -> np.ndarray:
        made = plant.with_values(dict(zip(names, values[: len(names)], strict=True)))
        states = values[len(names) :].reshape(len(runs), -1)
        found = [made.predict(replace(run, state=state)).points for run, state in zip(runs, states, strict=True)]
        return np.concatenate([((run.points - points) / NOISE).ravel() for run, points in zip(runs, found, strict=True)])

    start = np.concatenate([[plant.values[name] for name in names], *[[run.points[0, 0, 0], 0.0] for run in runs]])
    return least_squares(left, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14).x


def test_a_run_at_rest_is_left_alone(plant: CasadiPlant) -> None:
    run = swing((0.0, 0.0), "equilibrium")
    assert with_estimated_initial_state(plant, run, NOISE) is run


@pytest.mark.parametrize("state", [(0.3, 0.0), (-0.2, 1.5), (0.0, -2.0)])
@pytest.mark.parametrize(("start", "near"), [("free", 4.0), ("measured", 40.0)])
def test_the_state_is_found(plant: CasadiPlant, state: tuple[float, float], start: Start, near: float) -> None:
    right = plant.with_values({"spring": 24.0, "damping": 0.7})
    found = with_estimated_initial_state(right, swing(state, start), NOISE).state
    assert found is not None
    np.testing.assert_allclose(found, state, atol=near * NOISE)  # speed from 0.2 s of positions is worth less than from all of them


def test_measured_states_do_not_look_at_what_comes_later(plant: CasadiPlant) -> None:
    run = swing((0.3, 0.0), "measured")
    later = replace(run, points=run.points + np.where(np.arange(run.rows) < 20, 0.0, 0.1)[:, None, None])
    np.testing.assert_array_equal(
        with_estimated_initial_state(plant, run, NOISE).state, with_estimated_initial_state(plant, later, NOISE).state
    )
    free = [with_estimated_initial_state(plant, replace(each, start="free"), NOISE).state for each in (run, later)]
    assert np.abs(free[0] - free[1]).max() > 0.01


def test_missing_samples_do_not_count(plant: CasadiPlant) -> None:
    run = swing((0.3, 0.0), "free")
    gaps = run.points.copy()
    gaps[::3] = np.nan
    right = plant.with_values({"spring": 24.0, "damping": 0.7})
    np.testing.assert_allclose(with_estimated_initial_state(right, replace(run, points=gaps), NOISE).state, [0.3, 0.0], atol=5 * NOISE)


def test_a_state_that_shows_in_nothing_stays(plant: CasadiPlant) -> None:
    run = swing((0.3, 0.0), "free")
    empty = replace(run, points=np.full_like(run.points, np.nan))
    found = with_estimated_initial_state(plant, empty, NOISE).state
    assert found is not None
    np.testing.assert_array_equal(found, [0.0, 0.0])


def test_first_rows() -> None:
    run = first(swing((0.3, 0.0), "free"), 7)
    assert (run.rows, run.start, run.points.shape) == (7, "free", (7, 1, 1))


@pytest.mark.slow
@pytest.mark.parametrize("names", [["spring"], ["spring", "damping"]])
def test_projection_gives_what_a_joint_fit_gives(plant: CasadiPlant, names: list[str]) -> None:
    """Golub and Pereyra's point: the same minimum, whether states are parameters or taken out."""
    runs = [swing((0.3, 0.0), "free", 1), swing((-0.1, 1.0), "free", 2), swing((0.2, -1.0), "free", 3)]
    found = identify(Problem(plant, tuple(runs), plant.free(names), NOISE), 25, tolerance=1e-12)
    expected = joint(plant, runs, names)
    sigma = found.std
    np.testing.assert_allclose(found.values, expected[: len(names)], atol=0.02 * sigma.min(), rtol=1e-6)
    states = np.array([with_estimated_initial_state(found.plant, run, NOISE).state for run in runs])
    np.testing.assert_allclose(states.ravel(), expected[len(names) :], atol=1e-4)
    if "damping" in names:
        assert abs(found.named["spring"] - 24.0) < 4 * sigma[names.index("spring")]
        assert abs(found.named["damping"] - 0.7) < 4 * sigma[names.index("damping")]


def test_projected_residuals_and_derivatives_are_those_with_the_best_state() -> None:
    """Against the linear problem solved as a whole."""
    random = np.random.default_rng(3)
    by, values = random.normal(size=(30, 5)), random.normal(size=(30, 1, 1))
    residual = Residual("a.csv", values, np.ones((30, 1, 1), bool), by, np.zeros(30, int))
    cut = without_start(residual, 2)
    assert cut.by.shape == (30, 3)
    change = random.normal(size=3)
    best = np.linalg.lstsq(by[:, 3:], -(values.ravel() + by[:, :3] @ change), rcond=None)[0]
    np.testing.assert_allclose(cut.values.ravel() + cut.by @ change, values.ravel() + by[:, :3] @ change + by[:, 3:] @ best, atol=1e-12)


@pytest.mark.parametrize(
    "own", [np.zeros((30, 2)), np.repeat(np.arange(30.0)[:, None], 2, axis=1)], ids=["nothing shows", "the same twice"]
)
def test_projection_bears_states_that_do_not_show(own: np.ndarray) -> None:
    random = np.random.default_rng(4)
    residual = Residual(
        "a.csv", random.normal(size=(30, 1, 1)), np.ones((30, 1, 1), bool), np.hstack([random.normal(size=(30, 1)), own]), np.zeros(30, int)
    )
    cut = without_start(residual, 2)
    assert np.isfinite(cut.values).all()
    np.testing.assert_allclose(own.T @ cut.values.ravel(), 0.0, atol=1e-9)


def test_predictions_begin_where_runs_do(plant: CasadiPlant) -> None:
    right = plant.with_values({"spring": 24.0, "damping": 0.7})
    runs = [swing((0.3, 0.0), "free", 1), swing((0.0, 0.0), "equilibrium", 2)]
    for run, found in zip(runs, predictions(right, runs, NOISE), strict=True):
        assert np.sqrt(np.mean((run.points - found.points) ** 2)) < 1.2 * NOISE


def test_starts_by_name_are_derivatives(plant: CasadiPlant) -> None:
    run = replace(swing((0.3, 0.0), "free"), state=np.array([0.3, 0.2]))
    found = plant.predict(run, [START + "q", START + "v"])
    for k in range(2):
        step = np.zeros(2)
        step[k] = 1e-6
        high, low = (plant.predict(replace(run, state=run.state + sign * step)).points for sign in (1, -1))
        np.testing.assert_allclose(found.by[k], (high - low) / 2e-6, atol=1e-7)

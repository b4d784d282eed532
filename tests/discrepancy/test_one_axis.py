"""A machine with one axis — a mass on rails, a spring, a damper, an actuator — with data from its equation of motion."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tepm_opt.data.datasets import DataSet, write_dataset
from tepm_opt.data.run import Run
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.errors import InputError
from tepm_opt.jobs.discrepancy import run_discrepancy
from tepm_opt.models.channels import channels_of
from tepm_opt.models.compile import compile_model
from tepm_opt.models.model import Model
from tepm_opt.models.robot import load_robot
from tepm_opt.outcome import Ending
from tepm_opt.solvers.identification.identify import Problem, identify
from tepm_opt.solvers.mechanics.network_plant import NetworkPlant, free_parameters
from tepm_opt.solvers.mechanics.plant import PredictionError
from tepm_opt.solvers.mechanics.predict import predict
from tepm_opt.solvers.mechanics.simulate import Directions, simulate
from tepm_opt.solvers.mechanics.statics import solve_statics
from tests.discrepancy.small import changed

FILE = Path(__file__).resolve().parents[2] / "docs" / "one_axis.toml"
NOISE, STEP = 1e-4, 0.02
STIFFNESS, DAMPING, AREA, MASS = 3 * 119.62 * 1.02, 3 * 0.8611 * 1.2, 3 * 16.757e-6, 0.3 * 0.98


def motion(time: np.ndarray, pressure: np.ndarray, friction: float, filling: float) -> np.ndarray:
    """Elongation of m q'' + c q' + k q + dry friction = A p, the pressure lagging, LuGre's bristles without Stribeck effect."""
    bristle = 2e4  # N/m

    def rates(t: float, y: np.ndarray) -> list[float]:
        q, v, z, p = y
        slip = v - bristle * abs(v) / friction * z if friction else 0.0
        asked = np.interp(t, time, pressure)
        inside = asked if not filling else p
        force = AREA * inside - STIFFNESS * q - DAMPING * v - (bristle * z + 2.0 * slip if friction else 0.0)
        return [v, force / MASS, slip, (asked - p) / filling if filling else 0.0]

    start = [AREA * pressure[0] / STIFFNESS, 0.0, 0.0, pressure[0]]
    return solve_ivp(rates, time[[0, -1]], start, "LSODA", time, rtol=1e-8, atol=1e-10, max_step=0.01).y[0]


def data(folder: Path, friction: float = 0.0, filling: float = 0.0) -> Path:
    random = np.random.default_rng(5)
    robot = load_robot(FILE)
    runs = []
    for k, role in enumerate(("fit", "fit", "fit", "validation")):
        time = np.arange(0, 8, STEP)
        knots = np.concatenate([[0, 0], random.uniform(0.2e5, 3e5, 8), [0.2e5]])
        pressure = np.interp(time, np.linspace(0, 8, len(knots)), knots)
        q = motion(time, pressure, friction, filling)
        points = np.zeros((len(time), 2, 3))
        points[:, 0, 2], points[:, 1, 2] = (0.2 + q) / 2, 0.2 + q
        inputs = np.hstack([np.repeat(pressure[:, None], 3, axis=1), np.zeros((len(time), 3))])
        noisy = points + random.normal(0, NOISE, points.shape)
        runs.append(Run(f"run{k}.csv", role, time, inputs, np.zeros((len(time), 3)), noisy))  # type: ignore[arg-type]
    write_dataset(DataSet("one axis", str(FILE), channels_of(robot), tuple(runs), 1 / STEP, NOISE), folder)
    return folder


def test_a_guide_keeps_the_machine_straight_and_the_spring_holds_it() -> None:
    model = compile_model(FILE, backend="python")
    found = solve_statics(model, [2e5, 2e5, 2e5, 0, 0, 0], (0.5, 0.0, 0.0))
    assert found.solved
    assert found.tip[2] == pytest.approx(0.2 + 3 * 16.757e-6 * 2e5 / (3 * 119.62), rel=1e-4)
    assert abs(found.tip[0]) < 1e-4


def pushed(force: float) -> SetPoints:
    """Half a second of rest, then a push along the axis in N that grows within 0.1 s."""
    time = np.arange(0, 1.5, STEP)
    return SetPoints(time, np.zeros((len(time), 6)), np.outer(np.interp(time, [0.5, 0.6], [0.0, force]), [0.0, 0.0, 1.0]))


def passes_the_base(force: float) -> float:
    """When the equation of motion m q'' + c q' + k q = F brings the mass to the base, in s."""

    def rates(t: float, y: np.ndarray) -> list[float]:
        pushing = np.interp(t, [0.5, 0.6], [0.0, force])
        return [y[1], (pushing - 3 * 0.8611 * y[1] - 3 * 119.62 * y[0]) / 0.3]

    def there(t: float, y: np.ndarray) -> float:
        return float(y[0] + 0.2)

    there.terminal = True  # type: ignore[attr-defined]
    return float(solve_ivp(rates, (0.0, 1.5), [0.0, 0.0], rtol=1e-9, atol=1e-12, max_step=0.01, events=there).t[-1])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("backend", "step"),
    [("auto", 0.02), ("python", 0.02), *(pytest.param(backend, None, marks=pytest.mark.slow) for backend in ("auto", "python"))],
)
def test_a_mass_that_runs_through_its_base_is_told(backend: Literal["auto", "python"], step: float | None) -> None:
    model = compile_model(FILE, backend=backend)
    assert simulate(model, pushed(-40.0), step=step).solved, "it comes within 15 mm"
    found = simulate(model, pushed(-60.0), step=step)
    assert found.outcome.ending is Ending.FAILED
    assert "runs through the base" in found.outcome.message
    assert found.setpoints.time[-1] < passes_the_base(-60.0) < found.setpoints.time[-1] + STEP
    assert found.tip[:, 2].min() > 0
    asked = pushed(-60.0)
    run = Run("pushed.csv", "fit", asked.time, asked.inputs, asked.tip_force, np.zeros((len(asked.time), 2, 3)))
    with pytest.raises(PredictionError, match=r"pushed\.csv: .*runs through the base"):
        predict(model, run)


def test_there_is_no_equilibrium_beyond_the_base() -> None:
    model = compile_model(FILE, backend="python")
    found = solve_statics(model, np.zeros(6), (0.0, 0.0, -100.0))
    assert found.outcome.ending is Ending.COLLAPSED
    assert "runs through the base" in found.outcome.message
    assert found.reached == pytest.approx(0.75 * 0.2 * 3 * 119.62 / 100.0, abs=0.01), "where a muscle counts as collapsed"


@pytest.fixture(scope="module")
def springless(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The robot file of a mass that slides freely."""
    file = tmp_path_factory.mktemp("springless") / "robot.toml"
    text = FILE.read_text(encoding="utf-8").replace("K_a = 119.62 ", "K_a = 0 ").replace("K_a = 0.05\n", "")
    file.write_text(text, encoding="utf-8")
    return file


def sliding(time: np.ndarray, force: np.ndarray, mass: float, damping: float) -> np.ndarray:
    """Way of m v' = F - c v from rest, in m."""

    def rates(t: float, y: np.ndarray) -> list[float]:
        return [y[1], (np.interp(t, time, force) - damping * y[1]) / mass]

    return solve_ivp(rates, time[[0, -1]], [0.0, 0.0], t_eval=time, rtol=1e-9, atol=1e-12, max_step=0.01).y[0]


class TestWithoutASpring:
    @pytest.mark.slow
    @pytest.mark.parametrize("backend", ["auto", "python"])
    @pytest.mark.parametrize("how", [{}, {"step": 0.01}, {"method": "rk4"}], ids=["adaptive", "steps", "rk4"])
    def test_moves_as_a_mass_on_a_damper(self, springless: Path, backend: Literal["auto", "python"], how: dict[str, Any]) -> None:
        model, asked = compile_model(springless, backend=backend), pushed(0.3)
        found = simulate(model, asked, **how)
        assert found.solved, found.outcome
        expected = 0.2 + sliding(asked.time, asked.tip_force[:, 2], 0.3, 3 * 0.8611)
        assert found.tip[:, 2] == pytest.approx(expected, abs=2e-4)
        assert expected[-1] > 0.25

    @pytest.mark.slow
    @pytest.mark.parametrize("backend", ["auto", "python"])
    def test_its_motion_has_derivatives(self, springless: Path, backend: Literal["auto", "python"]) -> None:
        model, asked, h = compile_model(springless, backend=backend), pushed(0.3), 1e-3
        names = ["m_d", "c_a"]
        found = simulate(model, asked, step=STEP, directions=Directions.from_names(model, names)).sensitivities[:, :, -1, 2]
        for name, by in zip(names, found, strict=True):
            way = [simulate(changed(model, **{name: model.values[name] + d}), asked, step=STEP).tip[:, 2] for d in (h, -h)]
            assert by == pytest.approx((way[0] - way[1]) / (2 * h), abs=1e-4 * np.abs(by).max())

    @pytest.mark.slow
    def test_has_no_stable_equilibrium(self, springless: Path) -> None:
        model = compile_model(springless, backend="python")
        for force in (0.0, 1.0):
            found = solve_statics(model, np.zeros(6), (0.0, 0.0, force))
            assert not found.solved
            assert "nothing holds the robot" in found.outcome.message
            assert found.indifferent == (force == 0)
        asked = pushed(0.3)
        with pytest.raises(InputError, match="row 1: no stable equilibrium to start from: nothing holds the robot"):
            simulate(model, SetPoints(asked.time, asked.inputs, asked.tip_force + 0.1))

    @pytest.mark.slow
    def test_an_arm_without_stiffness_says_so(self) -> None:
        found = solve_statics(compile_model(Model.from_robot("kang2017").with_parameters(K_a=0.0), backend="python"), np.zeros(12))
        assert "nothing holds the robot" in found.outcome.message

    @pytest.mark.slow
    def test_its_mass_and_damper_are_identified(self, springless: Path) -> None:
        model, random = compile_model(springless), np.random.default_rng(3)
        time = np.arange(0, 6, STEP)
        force = np.interp(time, np.linspace(0, 6, 13), np.concatenate([[0, 0], random.uniform(-0.15, 0.25, 11)]))
        points = np.zeros((len(time), 2, 3))
        way = 0.2 + sliding(time, force, 0.3 * 0.97, 3 * 0.8611 * 1.2)
        points[:, :, 2] = way[:, None] * [0.5, 1.0]
        points += random.normal(0, NOISE, points.shape)
        run = Run("slides.csv", "fit", time, np.zeros((len(time), 6)), np.outer(force, [0, 0, 1]), points)
        found = identify(Problem(NetworkPlant(model), (run,), free_parameters(model), NOISE))
        assert found.solved, found.outcome
        assert np.abs((found.values - [0.3 * 0.97, 0.8611 * 1.2]) / found.std).max() < 3


@pytest.mark.parametrize(
    ("hidden", "name", "size"),
    [
        pytest.param({"friction": 0.8}, "structural_friction", None, marks=pytest.mark.slow),
        pytest.param({"filling": 0.15}, "regulator_lag", 0.15, marks=pytest.mark.slow),
        pytest.param({}, None, None, marks=pytest.mark.slow),
    ],
    ids=["friction", "lag", "nothing"],
)
def test_what_is_missing_on_one_axis(tmp_path: Path, hidden: dict[str, float], name: str | None, size: float | None) -> None:
    verdict = run_discrepancy(data(tmp_path / "data", **hidden), tmp_path / "out").verdict
    if name is None:
        assert verdict.status is VerdictStatus.NO_DISCREPANCY, verdict.paragraph
        return
    assert verdict.status is VerdictStatus.NAMED, verdict.paragraph
    assert [each.candidate.name for each in verdict.effects] == [name], verdict.paragraph
    assert verdict.errors.gap_closed_fraction > 0.9
    if size is not None:
        assert verdict.effects[0].parameters["filling_time"].value == pytest.approx(size, rel=0.05)

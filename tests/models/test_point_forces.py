"""Forces on points by place and velocity, and drag of edges: against equilibria under the same forces, another scheme, differences."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np
import pytest

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.effect import Effect, Parameter
from tepm_opt.models.effects import register, unregister
from tepm_opt.models.layout import VERTICAL
from tepm_opt.models.model import Model
from tepm_opt.solvers.linear.state_space import linearise
from tepm_opt.solvers.mechanics.simulate import Directions, simulate
from tepm_opt.solvers.mechanics.statics import solve_statics
from tests.tools import variant

PLACE = np.array([0.0, 0.02, 0.3])


class ToyHose(Effect):
    """A spring from the tip and, half as stiff, from the point below to a place."""

    name, explains, reference = "toy_hose", "a hose pulls at two points", "made up for this test"
    parameters = (Parameter("stiffness", "N/m", 0.0, 0.1),)

    def point_energy(self, point, position, parameters, context):
        share = {context.layout.points - 1: 1.0, context.layout.points - 2: 0.5}.get(point, 0.0)
        return share * parameters["stiffness"] / 2 * ca.sumsqr(position - ca.DM(PLACE))


class ToyFluid(Effect):
    """Drag with the square of the speed at s3."""

    name, explains, reference = "toy_fluid", "a fluid around a point", "made up for this test"
    parameters = (Parameter("drag", "N s²/m²", 0.0, 0.2),)

    def point_drag(self, point, position, velocity, parameters, context):
        return -parameters["drag"] * ca.sqrt(ca.sumsqr(velocity) + 1e-6) * velocity if point == 2 else ca.SX.zeros(3)


class ToyRub(Effect):
    """A force against the motion of every muscle that saturates."""

    name, explains, reference = "toy_rub", "muscles rub", "made up for this test"
    parameters = (Parameter("force", "N", 0.0, 1.0),)

    def edge_drag(self, edge, length, rate, parameters, context):
        return parameters["force"] * ca.tanh(rate / 0.005) if edge.kind == VERTICAL else ca.SX(0)


TOYS = (ToyHose(), ToyFluid(), ToyRub())


@pytest.fixture(scope="module")
def model() -> Iterator[Model]:
    for toy in TOYS:
        register(toy)
    found = Model.from_robot("kang2017")
    for toy in TOYS:
        found = found.with_effect(toy.name)
    yield found
    for toy in TOYS:
        unregister(toy.name)


@pytest.fixture(scope="module")
def compiled(model: Model) -> CompiledModel:
    return compile_model(model)


@pytest.fixture(scope="module")
def asked() -> SetPoints:
    time = np.arange(0, 2, 0.02)
    inputs = np.tile(np.append(np.full(6, 1e5), np.zeros(6)), (len(time), 1))
    inputs[:, 1] += 5e4 + 3e4 * np.sin(3 * time)
    inputs[:, 4] += 4e4 * np.clip(time - 1, 0, 0.2) / 0.2
    return SetPoints(time, inputs, np.zeros((len(time), 3)))


def hose(points: np.ndarray) -> np.ndarray:
    """Forces of the toy on the points, (…, 4, 3) in N."""
    return 0.1 * np.array([0, 0, 0.5, 1.0])[:, None] * (PLACE - points)


def test_an_equilibrium_is_the_one_under_its_forces(compiled: CompiledModel, kang: CompiledModel, asked: SetPoints) -> None:
    held = solve_statics(compiled, asked.inputs[0])
    constant = SetPoints(np.array([0.0, 0.1]), asked.inputs[[0, 0]], np.zeros((2, 3)))
    known = simulate(kang, constant, loads=np.tile(hose(held.points), (2, 1, 1)))
    assert np.abs(known.points[0] - held.points).max() < 1e-9
    assert np.abs(held.points - solve_statics(kang, asked.inputs[0]).points).max() > 1e-4
    python = solve_statics(compile_model(compiled.model, backend="python"), asked.inputs[0])
    assert np.abs(python.points - held.points).max() < 1e-10


def test_odd_segments_have_points_between_levels(model: Model) -> None:
    robot = variant(geometry={"segments_per_module": 3})
    held = solve_statics(compile_model(Model(robot, effects=model.effects), backend="python"), np.append(np.full(6, 1e5), np.zeros(6)))
    constant = SetPoints(np.array([0.0, 0.1]), np.tile(held.inputs, (2, 1)), np.zeros((2, 3)))
    known = simulate(compile_model(robot, backend="python"), constant, loads=np.tile(hose(held.points), (2, 1, 1)))
    assert np.abs(known.points[0] - held.points).max() < 1e-9


@pytest.mark.slow
def test_both_schemes_and_both_backends_agree(compiled: CompiledModel, kang: CompiledModel, asked: SetPoints) -> None:
    fine, explicit = simulate(compiled, asked, step=0.005), simulate(compiled, asked, "rk4")
    assert np.abs(fine.points - explicit.points).max() < 2e-5
    assert np.abs(fine.points - simulate(kang, asked, step=0.005).points).max() > 5e-3
    short = SetPoints(asked.time[:15], asked.inputs[:15], asked.tip_force[:15])
    twin = simulate(compile_model(compiled.model, backend="python"), short, step=0.02)
    assert np.abs(twin.points - simulate(compiled, short, step=0.02).points).max() < 1e-12


@pytest.mark.parametrize(("name", "change"), [("toy_hose.stiffness", 1e-4), ("toy_fluid.drag", 1e-3), ("toy_rub.force", 1e-2)])
def test_sensitivities_are_differences(compiled: CompiledModel, asked: SetPoints, name: str, change: float) -> None:
    found = simulate(compiled, asked, step=0.01, directions=Directions.from_names(compiled, [name]), tolerance=1e-11).sensitivities[0]
    at = compiled.network.parameter_names.index(name)

    def moved(by: float) -> np.ndarray:
        theta = compiled.theta + by * (np.arange(len(compiled.theta)) == at)
        return simulate(compiled.with_theta(theta), asked, step=0.01, tolerance=1e-11).points

    expected = (moved(change) - moved(-change)) / (2 * change)
    assert np.abs(found - expected).max() < 1e-3 * np.abs(expected).max()


def test_the_linear_system_knows_stiffness_and_drag(compiled: CompiledModel, kang: CompiledModel, asked: SetPoints) -> None:
    poles = [np.linalg.eigvals(linearise(solve_statics(m, asked.inputs[0])).A) for m in (compiled, kang)]
    slowest = [values[np.argmin(np.abs(values + 0.3 - 5.5j))] for values in poles]
    assert abs(slowest[0]) > 1.01 * abs(slowest[1])  # the hose stiffens the sway
    assert slowest[0].real < 2 * slowest[1].real  # and rubbing damps it

"""CasADi's function files, read back by CasADi alone."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from tepm_opt.exports.casadi_files import export_casadi
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.solvers.linear.gain import solve_gain
from tepm_opt.solvers.linear.state_space import linearise
from tepm_opt.solvers.mechanics.statics import Equilibrium, solve_statics


@pytest.fixture(scope="module")
def rich(kang: CompiledModel) -> CompiledModel:
    """The robot with effects on inputs, edges and loads."""
    model = kang.model
    for name in ("creep", "regulator_lag", "payload", "pressure_crosstalk"):
        model = model.with_effect(name)
    return compile_model(model, backend="python")


@pytest.fixture(scope="module")
def found(rich: CompiledModel) -> Equilibrium:
    """An equilibrium of it under inputs and forces on two points."""
    loads = np.zeros((4, 3))
    loads[1], loads[3] = [0.1, -0.2, 0.0], [0.2, 0.1, 0.0]
    return solve_statics(rich, 0.3 * np.linspace(0.2, 1.0, 12) * rich.input_max, loads)


@pytest.fixture(scope="module")
def read(rich: CompiledModel, tmp_path_factory: pytest.TempPathFactory) -> dict[str, ca.Function]:
    """The functions, by name."""
    files = export_casadi(rich, tmp_path_factory.mktemp("casadi"))
    return {path.stem: ca.Function.load(str(path)) for path in files}


def apart(found: ca.DM, expected: np.ndarray) -> float:
    return float(np.abs(np.array(found) - expected).max() / np.abs(expected).max())


def test_statics_and_gain(read: dict[str, ca.Function], found: Equilibrium) -> None:
    model, force = found.model, found.loads.ravel()
    start = solve_statics(model, 0.9 * found.inputs, found.loads)
    given = {"x0": start.x[1:].ravel(), "u": found.inputs, "force": force}
    statics = read["statics"](**given)
    assert apart(statics["x"], found.x[1:].reshape(-1, 1)) < 1e-9
    assert apart(statics["points"], found.points.reshape(-1, 1)) < 1e-9
    assert apart(statics["lengths"], found.lengths.reshape(-1, 1)) < 1e-9
    gain = np.vstack([solve_gain(found, point).matrix for point in range(4)])
    assert apart(read["gain"](**given)["gain"] @ ca.diag(model.input_max), gain * model.input_max) < 1e-9


def test_the_network_in_a_program_of_ones_own(read: dict[str, ca.Function], rich: CompiledModel) -> None:
    """IPOPT on the energy finds what our statics do."""
    network, u = read["network"], 0.1 * rich.input_max
    x = ca.MX.sym("x", network.size1_in(0))
    energy = network(x=x, u=u, force=np.zeros(12))["energy"]
    quiet = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-10}
    least = ca.nlpsol("least", "ipopt", {"x": x, "f": energy}, quiet)(x0=read["rest"]()["x"])
    expected = solve_statics(rich, u)
    assert apart(network(x=least["x"], u=u, force=0)["points"], expected.points.reshape(-1, 1)) < 1e-6


def test_motion_is_that_of_the_linearised_system(read: dict[str, ca.Function], found: Equilibrium) -> None:
    """Its derivatives are the state matrix, with the internal states of the muscles."""
    motion, expected = read["motion"], linearise(found, actuators=False)
    x, v, y = (ca.MX.sym(name, motion.numel_in(k)) for k, name in enumerate("xvy"))
    a = read["actuation"](found.inputs)
    moves = motion(x=x, v=v, y=y, a=a, force=found.loads.ravel())
    rate, state = ca.vertcat(v, moves["acceleration"], moves["rate"]), ca.vertcat(x, v, y)
    A = ca.Function("A", [x, v, y], [ca.jacobian(rate, state)])(found.x[1:].ravel(), 0, 0)
    assert apart(A, expected.A) < 1e-9


def test_a_start_too_far_away_is_an_error(read: dict[str, ca.Function], found: Equilibrium, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(RuntimeError, match="statics"):
        read["statics"](x0=read["rest"]()["x"], u=3 * found.inputs, force=found.loads.ravel())


def test_files_are_whole_or_absent(kang: CompiledModel, tmp_path: Path) -> None:
    export_casadi(kang, tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {f"{name}.casadi" for name in ("rest", "actuation", "network", "statics", "gain", "motion")}

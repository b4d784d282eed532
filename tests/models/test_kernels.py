"""C of CasADi's functions against CasADi itself."""

from __future__ import annotations

import ctypes

import casadi as ca
import numpy as np
import pytest

from tepm_opt.models.backends import compiler, kernels
from tepm_opt.models.backends.ccode import KERNEL_FLAGS
from tepm_opt.models.backends.compiled import statics_unit, stepping_unit
from tepm_opt.models.backends.kernels import PREAMBLE, Kernel
from tepm_opt.models.dynamics import write_dynamics
from tepm_opt.models.model import Model
from tepm_opt.models.network import write_network
from tests.tools import variant

LANES = 4
ALL = {
    "arithmetic": lambda x, y: [-x, 2 * x, x**2, 1 / x, x + y, x - y, x * y, x / y, x * 0.123456789, x + ca.inf, x + 12345.678],
    "logic": lambda x, y: [
        *(x < y, x <= y, x == y, x != y, ca.logic_and(x, y), ca.logic_or(x, y), ca.logic_not(x)),
        *(ca.sign(x), ca.sign(x - x), ca.sign(-y), ca.if_else(x < y, x, y), ca.if_else(x >= y, 0, y)),
    ],
    "of one": lambda x, y: [getattr(ca, name)(x) for name in kernels._OF_ONE if name != "acosh"] + [ca.acosh(1 + x)],
    "of two": lambda x, y: [x**y, x**2.5, ca.fmod(7 * y, x), ca.copysign(x, -y), ca.fmin(x, y), ca.fmax(x, y), ca.atan2(x, -y),
                            ca.hypot(x, y), ca.remainder(7 * y, x)],
    "zero": lambda x, y: [ca.SX(0), x, ca.SX(0), ca.SX(1), ca.SX(0)],
}  # fmt: skip


def run_c(function: ca.Function, lanes: bool, arguments: list[np.ndarray]) -> list[np.ndarray]:
    """Results of a function in C; with lanes the last axis of arguments and results is that of the lanes."""
    kernel = Kernel(function, lanes)
    name = function.name() + ("_lanes" if lanes else "")
    kind = "vector" if lanes else "double"
    entry = f"void enter(const {kind} *const *arg, {kind} *const *res) {{ {name}(arg, res); }}"
    text = "\n".join(
        (f"#define LANES {LANES}\n#define FORMULAS static\n#define CALL static", PREAMBLE, *kernel.formulas, kernel.call, entry)
    )
    library = compiler.build([compiler.Part("test", text, KERNEL_FLAGS)], "test", ("enter",), "nothing")
    assert library is not None
    wide = (LANES,) if lanes else ()
    results = [np.full((function.nnz_out(k), *wide), np.nan) for k in range(function.n_out())]
    given, taken = ((ctypes.c_void_p * len(each))(*(array.ctypes.data for array in each)) for each in (arguments, results))
    library.enter(given, taken)
    return results


@pytest.mark.parametrize("lanes", [False, True], ids=["scalars", "lanes"])
@pytest.mark.parametrize("kind", ALL)
def test_every_operation_is_casadis(kind: str, lanes: bool, compiler: None) -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    function = ca.Function("operations", [x, y], [ca.vertcat(*map(ca.SX, ALL[kind](x, y)))])
    points = np.array([[0.3, 0.7], [0.7, 0.3], [0.5, 0.5], [0.9, 0.0]])
    wanted = [np.array(function(*point)).ravel() for point in points]
    if lanes:
        found = run_c(function, True, [points[:, :1].T.copy(), points[:, 1:].T.copy()])[0].T
    else:
        found = np.array([run_c(function, False, [point[:1].copy(), point[1:].copy()])[0] for point in points])
    np.testing.assert_allclose(found, wanted, rtol=4e-16, atol=1e-16)


@pytest.mark.parametrize("lanes", [False, True], ids=["scalars", "lanes"])
@pytest.mark.parametrize("length", [1, 7, 50])
def test_pieces_of_any_length_are_the_whole(length: int, lanes: bool, compiler: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """A long function, whose values are needed near and far, sparse in argument and result."""
    monkeypatch.setattr(kernels, "PIECE", length)
    random, x, y = np.random.default_rng(length), ca.SX.sym("x", ca.Sparsity.lower(4)), ca.SX.sym("y", 3)
    values = [*ca.vertsplit(ca.vertcat(ca.SX(x.nz[:]), y)), ca.SX(0.1)]
    for _ in range(300):
        a, b = (values[k] for k in random.integers(0, len(values), 2))
        values.append(ca.sin(a) + random.uniform() * b)
    result = ca.SX(4, 4)
    for k, value in enumerate(values[-12:]):
        result[k // 4, k % 4] = value
    function = ca.Function("winding", [x, y], [result, ca.SX.zeros(2, 1)])
    arguments = [random.uniform(size=(n, *((LANES,) if lanes else ()))) for n in (10, 3)]
    found = run_c(function, lanes, arguments)
    for lane in range(LANES if lanes else 1):
        first, second = (each[:, lane] if lanes else each for each in arguments)
        wanted = function(ca.DM(x.sparsity(), first), second)[0].nonzeros()
        np.testing.assert_allclose(found[0][:, lane] if lanes else found[0], wanted, rtol=1e-13)
    assert not found[1].any()


def test_what_has_no_c_is_named() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(ValueError, match="odd: no C for instruction"):
        Kernel(ca.Function("odd", [x], [ca.erfinv(x)]))


def all_formulas(model: Model) -> dict[str, str]:
    """Texts that are compiled apart, by unit and kernel."""
    units = statics_unit(write_network(model)), stepping_unit(write_dynamics(model))
    return {f"{unit.stem} {name}": text for unit in units for name, text in unit.parts.items() if name not in ("loops", "tables")}


def test_another_robot_of_the_same_build_compiles_no_formulas() -> None:
    one, other = (
        variant(
            parameters={"L_0": length, "K_a": 2000 * length},
            mount={"base_position_m": [0.013, length / 7, -0.077]},
            tracker={"latency_s": late},
        )
        for length, late in ((0.2, 0.015), (0.25, 0.02))
    )
    assert all_formulas(Model.from_robot(one)) == all_formulas(Model.from_robot(other))


def test_an_effect_compiles_the_kernels_in_which_it_acts() -> None:
    model = Model.from_robot("kang2017")
    known, more = all_formulas(model), all_formulas(model.with_effect("stiffness_hardening", cubic=1e4))
    changed = {name for name in known if known[name] != more[name]}
    assert all("segment" in name for name in changed)
    assert len(changed) < len(known) / 2
    known, more = all_formulas(model), all_formulas(model.with_effect("sensor_misalignment"))
    assert {name for name in known if known[name] != more[name]} == {
        *("statics observe", "statics observe_adjoint", "time_stepping observe", "time_stepping observe_by"),
    }  # fmt: skip

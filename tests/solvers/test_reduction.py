"""Reduced systems: the bound holds, the gain at rest stays, what is wrong is refused. Modes and their shapes in words."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.models.compile import compile_model
from tepm_opt.models.model import Model
from tepm_opt.solvers.linear.modes import direction_in_words, modes, poles
from tepm_opt.solvers.linear.reduction import balanced_reduction, difference, modal
from tepm_opt.solvers.linear.state_space import Linear, linearise
from tepm_opt.solvers.mechanics.statics import solve_statics
from tests.solvers.dynamics import with_dynamics

BENT = np.array([1e5, 0, 2e5, 3e5, 1e5, 0, 1, 2, 3, 4, 5, 6.0])
SWEEP = np.unique(np.concatenate([np.geomspace(1e-3, 3e3, 50), np.linspace(0.8, 1.4, 21)]))  # Hz; the second around the sway
CHOICES = {"all": (None, None), "tip": (("pressure", "tension"), "s4"), "one": ("pressure_11", "s4_y")}


@pytest.fixture(scope="module")
def systems(kang) -> dict[str, Linear]:
    real = with_dynamics(
        structural_friction={"force": 0.2, "distance": 1e-3}, time_delay={"delay": 0.005},
        creep={"share": 0.2, "relaxation_time": 1.0}, regulator_lag={"filling_time": 0.12, "exhausting_time": 0.24},
    )  # fmt: skip
    return {
        "rest": linearise(solve_statics(kang, np.zeros(12))),
        "bent": linearise(solve_statics(kang, BENT)),
        "loaded": linearise(solve_statics(kang, BENT / 2, [1.5, 0.5, 0.0])),
        "with effects": linearise(solve_statics(compile_model(real), BENT)),
    }


def worst(reduced: Linear, whole: np.ndarray) -> float:
    """Largest difference over the sweep; `whole` is the full system's response."""
    return float(np.linalg.norm(whole - reduced.response(SWEEP, scaled=True), ord=2, axis=(1, 2)).max())


@pytest.mark.sample(3)
@pytest.mark.parametrize("choice", CHOICES)
@pytest.mark.parametrize("at", ["rest", "bent", *(pytest.param(at, marks=pytest.mark.slow) for at in ("loaded", "with effects"))])
def test_balanced_reduction_keeps_its_bound(systems, at, choice):
    full = systems[at].select(*CHOICES[choice])
    whole = full.response(SWEEP, scaled=True)
    cases = [(order, exact) for order in ((2, 4, 8) if choice == "one" else (2, 4, 12, 30)) for exact in (True, False)]
    for order, exact_gain in cases:
        reduced = balanced_reduction(full, order, exact_gain=exact_gain)
        assert len(reduced.A) == order
        assert np.linalg.eigvals(reduced.A).real.max() < 0
        assert 1e-3 * reduced.bound < worst(reduced, whole) <= reduced.bound
        if exact_gain:
            np.testing.assert_allclose(reduced.gain(), full.gain(), rtol=1e-9, atol=1e-15)
        else:
            np.testing.assert_array_equal(reduced.D, full.D)
        assert (np.diff(reduced.hankel) <= 0).all()


@pytest.mark.sample(3)
@pytest.mark.parametrize("choice", CHOICES)
@pytest.mark.parametrize("at", ["rest", "bent", "with effects"])
def test_modal_reduction_keeps_its_bound_and_modes(systems, at, choice):
    full = systems[at].select(*CHOICES[choice])
    whole = full.response(SWEEP, scaled=True)
    for below in (1.6, 30.0):
        reduced = modal(systems[at], below, *CHOICES[choice])
        assert worst(reduced, whole) <= reduced.bound
        np.testing.assert_allclose(reduced.gain(), full.gain(), rtol=1e-9, atol=1e-9 * abs(full.gain()).max())
        kept = np.sort(abs(np.linalg.eigvals(reduced.A)))
        all_of_them = np.sort(abs(np.linalg.eigvals(full.A)))
        np.testing.assert_allclose(kept, all_of_them[all_of_them <= 2 * np.pi * below], rtol=1e-7)


def test_eight_states_do_for_one_channel(systems):
    reduced = balanced_reduction(systems["rest"], tolerance=1e-5, inputs="pressure_11", outputs="s4_y")
    assert len(reduced.A) <= 8
    assert difference(systems["rest"], reduced, SWEEP).max() <= reduced.bound <= 1e-5
    assert reduced.to_control().input_labels == ["pressure_11"]
    two = balanced_reduction(systems["rest"], 2, inputs="pressure_11", outputs="s4_y")
    np.testing.assert_allclose(sorted(np.linalg.eigvals(two.A).imag), [-5.642, 5.642], atol=0.01)
    assert (
        systems["with effects"].delay == balanced_reduction(systems["with effects"], 6, inputs="pressure_11").delay == pytest.approx(0.005)
    )


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (lambda s: balanced_reduction(s), "either an order or a tolerance"),
        (lambda s: balanced_reduction(s, 4, tolerance=1e-3), "either an order or a tolerance"),
        (lambda s: balanced_reduction(s, 0), "order: 0; valid: 1 …"),
        (lambda s: balanced_reduction(s, 500), "order: 500; valid: 1 …"),
        (lambda s: balanced_reduction(s, tolerance=0.0), "tolerance: 0; valid: at least"),
        (lambda s: balanced_reduction(s, tolerance=float("nan")), "tolerance: nan"),
        (lambda s: balanced_reduction(s, 4, outputs="tip"), "unknown output 'tip'"),
        (lambda s: modal(s, 0.1), "below: 0.1 Hz; valid: 0.89"),
        (lambda s: modal(s, 1e6), "below: 1e"),
    ],
)
def test_wrong_orders_are_refused(systems, wrong, says):
    with pytest.raises(InputError, match=says) as error:
        wrong(systems["rest"])
    assert "\n" not in str(error.value)


def test_unstable_systems_are_refused(kang):
    at = solve_statics(compile_model(Model.from_robot("kang2017").with_effect("payload", mass=1.0), backend="python"), np.zeros(12))
    assert at.outcome.ending == "unstable"
    linear = linearise(at)
    assert any(mode.damping < 0 and mode.time_constant < 0 for mode in modes(linear))
    for reduce in (lambda: balanced_reduction(linear, 4), lambda: modal(linear, 2.0)):
        with pytest.raises(InputError, match="unstable"):
            reduce()


def test_modes_are_the_poles_and_add_up(systems):
    for name, linear in systems.items():
        found = modes(linear)
        if name in ("rest", "bent"):
            values = np.array([v for mode in found for v in ([mode.value, mode.value.conjugate()] if mode.oscillates else [mode.value])])
            np.testing.assert_allclose(np.sort(abs(values)), np.sort(abs(poles(linear.equilibrium))), rtol=1e-9)
        steady, gain = sum(mode.steady for mode in found), linear.gain()
        assert abs((steady - gain) * linear.ranges).max() < 1e-9 * abs(gain * linear.ranges).max()
        size = np.linalg.norm(linear.A, 2)
        for mode in found:
            assert mode.left @ mode.right == pytest.approx(1, abs=1e-9)
            residual = mode.linear.A @ mode.right - mode.value * mode.right
            assert np.linalg.norm(residual) < 1e-7 * size * np.linalg.norm(mode.right)


def test_sway_of_the_straight_arm_is_told_along_its_axes(systems):
    first, second, twist, *_ = modes(systems["rest"])
    assert (first.words, second.words) == ("sway: first bending along x", "sway: first bending along y")
    assert first.multiplicity == second.multiplicity == 2
    for mode, axis in ((first, 0), (second, 1)):
        assert mode.frequency == pytest.approx(5.642 / (2 * np.pi), abs=1e-4)
        assert mode.damping == pytest.approx(0.245 / np.hypot(0.245, 5.642), abs=1e-4)
        assert mode.time_constant == pytest.approx(1 / 0.245, rel=2e-3)
        tip = mode.points[-1]
        assert tip[axis] == pytest.approx(1.0, abs=0.02)
        assert abs(np.delete(tip, axis)).max() < 1e-6
        assert np.linalg.norm(mode.levels, axis=-1).max() == pytest.approx(1.0, abs=1e-6)
        assert not mode.levels[0].any()
    assert twist.words == "first twist"
    assert abs(twist.value - (-4.077 + 33.07j)) < 5e-3
    assert abs(twist.points).max() < 1e-6
    assert [mode.words for mode in modes(systems["rest"])[3:6]] == ["second bending along x", "second bending along y", "first lengthening"]


def test_memory_is_told_from_motion(systems):
    found = modes(systems["with effects"])
    kinds = [mode.memory for mode in found]
    assert kinds.count("memory of the muscles") == 2 * 36  # a quick and a slow part each
    assert kinds.count("memory of the actuation") == 6
    sway = next(mode for mode in found if not mode.memory)
    assert sway.words.startswith("sway: first bending along")
    driven = [
        int(np.argmax(abs(mode.steady[9:12, :12] * mode.linear.ranges[:12]).max(axis=0))) for mode in found if "actuation" in mode.memory
    ]
    assert sorted(driven) == list(range(6))  # one mode a regulator, although all have the same time constant


@pytest.mark.parametrize(
    ("direction", "words"),
    [
        ([0, 0, -2.0], "z"),
        ([-1, 0.05, 0], "x"),
        ([1, 1, 0], "45° from x towards y"),
        ([-1, 1, 0.1], "45° from x towards -y"),
        ([0.6, 0, 0.8], "(0.60, 0.00, 0.80)"),
    ],
)
def test_directions(direction, words):
    assert direction_in_words(np.array(direction, dtype=float)) == words


def test_a_reduced_system_is_linear_again_but_has_no_modes(systems):
    """Its operating point stays; what is selected of it is what is reduced of the selected."""
    whole = balanced_reduction(systems["rest"], 12)
    assert whole.equilibrium is systems["rest"].equilibrium
    part = whole.select("pressure_11", "s4")
    np.testing.assert_allclose(part.response(SWEEP), whole.response(SWEEP)[:, 9:12, :1], rtol=1e-9, atol=1e-18)
    assert part.to_control(pade=0).state_labels == list(part.state_names) == [f"state_{k + 1}" for k in range(12)]
    with pytest.raises(InputError, match="a reduced system has no motions of nodes"):
        modes(whole)

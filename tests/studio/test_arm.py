"""The operating point: dragged tips against statics from rest, inputs against known values, ellipsoids against differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.studio import arm
from tepm_opt.studio.arm import KINDS, drag_tip, off_grid, set_inputs
from tests.tools import variant

BESIDE = np.array([0.12, -0.05, 0.34])
OUTSIDE = np.array([0.30, 0.20, 0.35])


@pytest.mark.parametrize("mode", ActuationMode)
def test_a_dragged_tip_is_reached(kang: CompiledModel, mode: ActuationMode) -> None:
    """Also when statics starts from rest, and from one place to the next."""
    last = None
    for target in (BESIDE, BESIDE + np.array([0.01, 0.02, 0.0])):
        last = drag_tip(kang, target, mode, last)
        assert last.asked is not None
        assert last.asked.solved
        assert last.limits == ()
        np.testing.assert_allclose(solve_statics(kang, last.held.inputs).tip, target, atol=1e-6)


def test_out_of_reach(kang: CompiledModel) -> None:
    """The nearest point is shown, what binds is named, and a place a little nearer to the hand is out of reach, too."""
    point = drag_tip(kang, OUTSIDE)
    assert point.asked is not None
    assert point.asked.outcome.ending is Ending.OUT_OF_REACH
    miss = np.linalg.norm(point.held.tip - OUTSIDE)
    assert point.asked.miss == pytest.approx(miss, abs=1e-6)
    assert point.limits
    half = kang.layout.inputs // 2
    names = [f"{kind}_{name}" for kind in KINDS for name in kang.layout.actuator_names]
    for limit in point.limits:
        name, _, end = limit.partition(" at ")
        used = point.held.inputs[names.index(name)] / kang.input_max[names.index(name)]
        assert used == pytest.approx({"its maximum": 1.0, "0": 0.0}[end], abs=0.01)
        assert point.bound[names.index(name) % half]
    assert point.bound.sum() == len(point.limits)
    nearer = point.held.tip + 0.02 * (OUTSIDE - point.held.tip) / miss
    closer = drag_tip(kang, nearer, last=point)
    assert closer.asked is not None
    assert not closer.asked.solved


def test_a_search_that_fails_leaves_the_arm(kang: CompiledModel, monkeypatch: pytest.MonkeyPatch) -> None:
    before = drag_tip(kang, BESIDE)
    assert before.asked is not None
    lost = replace(before.asked, outcome=Outcome(Ending.FAILED, "no way"))
    monkeypatch.setattr(arm, "solve_ik", lambda *given, **named: lost)
    after = drag_tip(kang, OUTSIDE, last=before)
    assert after.held is before.held
    assert after.asked is lost
    assert drag_tip(kang, OUTSIDE).held.inputs.max() == 0


@pytest.mark.parametrize(("first", "second", "height"), [(0.0, 0.0, 0.396814), (2e5, 3e5, 0.446164)])
def test_inputs_that_are_set(kang: CompiledModel, first: float, second: float, height: float) -> None:
    """Heights above the base plate of the specification's check values."""
    point = set_inputs(kang, np.repeat([first, second, 0.0], [3, 3, 6]))
    assert point.held.tip[2] - kang.robot.mount.base_position_m[2] == pytest.approx(height, abs=1e-6)
    assert point.limits == ()


def test_inputs_that_are_too_large_end_at_their_limits(kang: CompiledModel) -> None:
    inputs = np.zeros(12)
    inputs[[1, 9]] = 1e9
    inputs[0] = -1.0
    point = set_inputs(kang, inputs, set_inputs(kang, np.zeros(12)))
    assert point.limits == ("pressure_12 at its maximum", "tension_21 at its maximum")
    np.testing.assert_array_equal(np.flatnonzero(point.bound), [1, 3])
    assert point.held.inputs[0] == 0


@pytest.mark.parametrize("kind", KINDS)
def test_ellipsoids(kang: CompiledModel, kind: str) -> None:
    """Their image of the unit ball is that of central differences of statics."""
    point = drag_tip(kang, BESIDE)
    found = point.ellipsoid(kind, 0.1)  # type: ignore[arg-type]
    assert found is not None
    lengths, directions = found
    assert np.linalg.det(directions) == pytest.approx(1.0)
    first, columns = (0 if kind == "pressure" else 6), []
    for place in range(first, first + 6):
        step = np.zeros(12)
        step[place] = 1e-4 * kang.input_max[place]
        up, down = (solve_statics(kang, point.held.inputs + sign * step, start=point.held).tip for sign in (1, -1))
        columns.append((up - down) / 2e-4)
    jacobian = 0.1 * np.array(columns).T
    np.testing.assert_allclose(directions @ np.diag(lengths**2) @ directions.T, jacobian @ jacobian.T, rtol=1e-4, atol=1e-9)


def test_off_the_grids(kang: CompiledModel) -> None:
    """Half a regulator's step of the third muscle moves the tip by what G says; on the grid nothing is off."""
    inputs = np.zeros(12)
    inputs[:3] = 20 * 4500.0
    assert off_grid(set_inputs(kang, inputs)) < 1e-9
    inputs[2] += 2000.0
    point = set_inputs(kang, inputs)
    assert point.gain is not None
    assert off_grid(point) == pytest.approx(np.linalg.norm(2000.0 * point.gain.matrix[:, 2]), rel=0.05)
    dragged = drag_tip(kang, BESIDE)
    assert dragged.asked is not None
    rounded = solve_statics(kang, dragged.asked.allocation.rounded)
    assert off_grid(dragged) == pytest.approx(np.linalg.norm(rounded.tip - BESIDE), abs=1e-6)


def test_an_arm_that_falls_over() -> None:
    """Four times as heavy it does not stand: no G, no ellipsoid, no number for the grids."""
    point = set_inputs(compile_model(variant(parameters={"m_d": 0.9}), backend="python"), np.zeros(12))
    assert not point.held.solved
    assert point.gain is None
    assert point.ellipsoid("pressure", 0.1) is None
    assert np.isnan(off_grid(point))

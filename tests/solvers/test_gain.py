"""The open-loop gain G (Eq. (6)) against differences of statics, and what the paper says about it (Fig. 11)."""

from dataclasses import replace

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.kinematics.ik import solve_ik, solve_trajectory
from tepm_opt.solvers.linear.gain import gain_at, input_curve, solve_gain, workspace_map
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.solvers.planning.trajectories import circle
from tests.tools import PRECISE, random_directions, random_inputs, relative, slope

AREA = 50.27e-6


def differences(model, u, force, part):
    """Derivative of all points (12, 12) by every input, in m per range of the input."""
    held = solve_statics(model, u, force, settings=PRECISE)

    def points(h, axis):
        return solve_statics(model, u + h * axis * model.input_max, force, held, PRECISE).points.ravel()

    return np.stack([slope(lambda h, axis=axis: points(h, axis), part) for axis in np.eye(len(u))], axis=1)


def test_at_50_operating_points(kang):
    """Relative error of each of the blocks, by pressures and by tensions, of all four points."""
    for u, force in zip(random_inputs(kang, 50, 0, 0.02, 0.98), 0.3 * random_directions(50, 1), strict=True):
        held = solve_statics(kang, u, force)
        expected = differences(kang, u, force, 5e-4)
        for point in range(4):
            found = solve_gain(held, point).normalise()
            rows = slice(3 * point, 3 * point + 3)
            for block in (slice(0, 6), slice(6, 12)):
                assert relative(found[:, block], expected[rows, block]) < 1e-6


def test_by_load_is_the_compliance(kang):
    """Against differences for loads on every point; reciprocity (Maxwell, Betti) makes the tip's own block symmetric."""
    for u in random_inputs(kang, 5, 2):
        held = solve_statics(kang, u, settings=PRECISE)
        gains = [solve_gain(held, point) for point in range(4)]
        for at in range(4):
            for axis in range(3):

                def moved(h, at=at, axis=axis, u=u, held=held):
                    loads = np.zeros((4, 3))
                    loads[at, axis] = h
                    return solve_statics(kang, u, loads, held, PRECISE).points

                expected = slope(moved, 1e-3)
                found = np.array([gain.by_load[:, at, axis] for gain in gains])
                assert relative(found, expected) < 1e-6
        compliance = np.array([gain.by_load for gain in gains]).reshape(12, 12)
        assert abs(compliance - compliance.T).max() < 1e-12 * abs(compliance).max()
        assert np.linalg.eigvalsh(compliance)[0] > 0


def test_by_parameter(kang):
    u, force = random_inputs(kang, 1, 3)[0], [0.3, -0.2, 0.1]
    gain = solve_gain(solve_statics(kang, u, force, settings=PRECISE), parameters=True)
    for at, (name, value) in enumerate(kang.model.values.items()):

        def tip(h, at=at):
            theta = kang.theta.copy()
            theta[at] += h
            return solve_statics(replace(kang, theta=theta), u, force, settings=PRECISE).tip

        expected = slope(tip, 1e-3 * value)
        if name in ("c_a", "beta_1", "beta_2"):
            assert not gain.by_parameter[:, at].any()
        else:
            assert relative(gain.by_parameter[:, at], expected) < 1e-6
    assert solve_gain(gain.equilibrium).by_parameter is None


def test_a_pressure_is_a_tension_in_si(kang):
    """F_a = p A - lambda: g_3,9 = -g_3,3 / A, all columns alike."""
    for u in random_inputs(kang, 5, 4):
        matrix = solve_gain(solve_statics(kang, u)).matrix
        assert relative(matrix[:, 6:], -matrix[:, :6] / AREA) < 1e-12


def test_symmetric_robot(kang):
    """At rest G turns with the actuators, and equal pressures lift without bending."""
    matrix = solve_gain(solve_statics(kang, np.zeros(12))).matrix
    c, s = np.cos(2 * np.pi / 3), np.sin(2 * np.pi / 3)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(turn @ matrix[:, :2], matrix[:, 1:3], atol=1e-12 * abs(matrix[:, :6]).max())
    lift = matrix[:, :3].sum(axis=1)
    assert lift[2] > 0
    assert np.linalg.norm(lift[:2]) < 1e-9 * lift[2]
    assert matrix[1, 0] < 0  # actuator 1, on +y, pushes the tip to -y


class TestFigure11:
    """IV.D: z_s4 falls with p_13 and with lambda_13 over 10 … 20 % and 45 … 55 % of range, the other inputs zero."""

    @pytest.mark.parametrize(("low", "high"), [(0.10, 0.20), (0.45, 0.55)])
    def test_signs_and_order(self, kang, low, high):
        curves = {name: input_curve(kang, name, "13", low, high) for name in ("pressure", "tension")}
        for curve in curves.values():
            assert np.diff(curve.tip[:, 2]).max() < 0
            assert curve.slope[:, 2].max() < 0
            assert (curve.part[0], curve.part[-1], len(curve.part)) == (low, high, 21)
            mid = (curve.tip[2:] - curve.tip[:-2]) / (curve.part[2:] - curve.part[:-2])[:, None]
            np.testing.assert_allclose(curve.slope[1:-1], mid, rtol=5e-3, atol=1e-4)  # central differences along the curve
        assert (curves["pressure"].slope[:, 2] < 3 * curves["tension"].slope[:, 2]).all()  # |g_3,3| > 3 |g_3,9| normalised

    def test_only_that_input_is_used(self, kang):
        curve = input_curve(kang, "tension", "13", 0.1, 0.2, 3)
        for part, tip in zip(curve.part, curve.tip, strict=True):
            u = np.zeros(12)
            u[8] = 7 * part
            np.testing.assert_allclose(solve_statics(kang, u).tip, tip, atol=1e-9)

    def test_an_unknown_actuator_is_refused(self, kang):
        with pytest.raises(InputError, match=r"unknown actuator '31': .*valid: 11, 12, 13, 21, 22, 23"):
            input_curve(kang, "pressure", "31")


def test_it_is_continuous_along_the_circle(kang):
    """G turns once with the circle's angle; between neighbours of 32 it changes by about 2 pi / 32 and never jumps."""
    found = solve_trajectory(kang, circle(32).positions, ActuationMode.HYBRID)
    gains = np.array([gain_at(configuration).normalise() for configuration in found])
    steps = np.linalg.norm(gains - np.roll(gains, 1, axis=0), axis=(1, 2)) / np.linalg.norm(gains, axis=(1, 2))
    assert 0.05 < steps.min() < steps.max() < 0.3
    halves = solve_trajectory(kang, circle(64).positions, ActuationMode.HYBRID)
    finer = np.array([gain_at(configuration).normalise() for configuration in halves])
    smaller = np.linalg.norm(finer - np.roll(finer, 1, axis=0), axis=(1, 2)) / np.linalg.norm(finer, axis=(1, 2))
    assert smaller.max() < 0.6 * steps.max()


def test_measures(kang):
    gain = solve_gain(solve_statics(kang, random_inputs(kang, 1, 5)[0]))
    for actuation, columns in {"pressure": slice(0, 6), "tension": slice(6, 12), "both": slice(0, 12)}.items():
        block = (gain.matrix * kang.input_max)[:, columns]
        np.testing.assert_array_equal(gain.normalise(actuation), block)
        values = np.sqrt(np.linalg.eigvalsh(block @ block.T))[::-1]
        np.testing.assert_allclose(gain.singular_values(actuation), values, rtol=1e-8)
        assert gain.condition(actuation) == pytest.approx(values[0] / values[2], rel=1e-8)
        assert gain.manipulability(actuation) == pytest.approx(np.sqrt(np.linalg.det(block @ block.T)), rel=1e-8)
    # 0.5 MPa on a muscle is 25.1 N, the tendons pull 7 N: pressure reaches 3.6 times as far
    assert gain.manipulability("pressure") / gain.manipulability("tension") == pytest.approx((0.5e6 * AREA / 7) ** 3, rel=1e-9)


def test_no_gain_where_there_is_no_stable_equilibrium(kang):
    buckled = solve_statics(kang, np.zeros(12), [0, 0, -3.0])
    with pytest.raises(ValueError, match="no gain at this operating point: the equilibrium is unstable"):
        solve_gain(buckled)


@pytest.mark.parametrize("point", [4, -5])
def test_no_such_point(kang, point):
    with pytest.raises(ValueError, match=f"point {point}; valid: 0 … 3"):
        solve_gain(solve_statics(kang, np.zeros(12)), point)


def test_workspace_map(kang):
    """Every grid point, counted from the base plate, is reached or not as by itself; a third of a turn changes nothing."""
    across, height = [0.0, 0.2, 0.35], [0.4, 0.65]
    found = workspace_map(kang, across, height)
    assert found.reached.shape == (2, 3)
    for row, z in enumerate(height):
        for column, x in enumerate(across):
            target = [x, 0, z - 0.05]
            alone = solve_ik(kang, target)
            assert found.reached[row, column] == alone.solved
            if alone.solved:
                np.testing.assert_allclose(found.gains[row][column].equilibrium.tip, target, atol=1e-6)
    numbers = found.values(lambda gain: gain.manipulability())
    assert 1 < found.reached.sum() < 6
    np.testing.assert_array_equal(np.isfinite(numbers), found.reached)
    turned, straight = (workspace_map(kang, across, height, turn, ActuationMode.PRESSURE) for turn in (2 * np.pi / 3, 0.0))
    np.testing.assert_array_equal(turned.reached, straight.reached)
    np.testing.assert_allclose(turned.values(lambda gain: gain.condition()), straight.values(lambda gain: gain.condition()), rtol=1e-6)

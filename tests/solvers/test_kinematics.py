"""Equal-curvature inverse kinematics: what is found holds in statics, what is not found is out of reach indeed."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.models.compile import compile_model
from tepm_opt.outcome import Ending
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.kinematics.allocation import force_range
from tepm_opt.solvers.kinematics.ik import IkSettings, each_configuration, solve_ik, solve_trajectory
from tepm_opt.solvers.mechanics.statics import Equilibrium, solve_actuated_statics, solve_statics
from tepm_opt.solvers.planning.trajectories import circle
from tests.tools import in_company, random_directions, variant

AREA = 50.27e-6
CIRCLE = circle().positions
MODES = list(ActuationMode)


def check_held(model, found, loads=None):
    """Statics under the set points, solved on its own from rest, ends at the target with equal curvatures."""
    held = solve_statics(model, found.allocation.inputs, loads)
    assert held.solved
    assert np.linalg.norm(held.tip - found.target) < 1e-6
    assert abs(held.lengths - held.lengths[0]).max() < 1e-7
    assert found.miss < 1e-6
    assert found.allocation.error < 1e-6
    return held


@dataclass
class Reachable:
    """An equal-curvature configuration made without inverse kinematics."""

    forces: np.ndarray
    held: Equilibrium


def equal_curvature(model, first) -> Reachable | None:
    """Given the first module's forces, the second's by Newton on the length differences; None where that fails."""
    weights = np.hstack([np.zeros((3, 12)), -np.eye(3), np.eye(3)])
    forces, held = np.tile(first, 2), None
    for _ in range(25):
        held = solve_actuated_statics(model, np.concatenate([forces / AREA, np.zeros(6)]), np.zeros((4, 3)), held, explain=True)
        if not held.solved:
            return None
        different = held.lengths[1] - held.lengths[0]
        if abs(different).max() < 1e-12:
            return Reachable(forces, held)
        by_force = model.statics.sensitivity(held.x, held.load_case, weights, False)[1][:, 3:6] / AREA
        forces = forces - np.concatenate([np.zeros(3), np.linalg.solve(by_force, different)])
    return None


@pytest.fixture(scope="module")
def cloud(kang):
    """By mode: configurations spread over all that the limits allow (some 500 and 650)."""
    found = {}
    for mode in MODES:
        low, high = force_range(kang, mode)
        rng = np.random.default_rng(0)
        tried = [equal_curvature(kang, rng.uniform(low[:3], high[:3])) for _ in range(2000)]
        found[mode] = [c for c in tried if c and (c.forces >= low).all() and (c.forces <= high).all()]
        assert len(found[mode]) > 400
    return found


class TestCircle:
    """Eq. (7) with 32 points, the paper's Fig. 12."""

    @pytest.fixture(params=MODES, ids=lambda mode: mode.value)
    def found(self, request, kang):
        return request.param, solve_trajectory(kang, CIRCLE, request.param)

    def test_every_point_is_held(self, kang, found):
        mode, configurations = found
        for configuration in configurations:
            assert configuration.solved
            assert configuration.limits == ()
            assert configuration.outcome.message == ""
            check_held(kang, configuration)
        if mode is ActuationMode.PRESSURE:
            assert not any(configuration.allocation.inputs[6:].any() for configuration in configurations)

    def test_force_range(self, found):
        """SPEC section 1: F_a 4.8 … 13.9 N."""
        forces = np.array([configuration.forces for configuration in found[1]])
        assert forces.min() == pytest.approx(4.8, abs=0.05)
        assert forces.max() == pytest.approx(13.9, abs=0.06)  # 32 points; on a fine circle 13.87

    def test_rounding_to_the_actuators_grids(self, kang, found):
        """Within 0.05 mm with tension, some millimetres with the regulator's 4.5 kPa alone."""
        mode, configurations = found
        rounded = [solve_statics(kang, configuration.allocation.rounded) for configuration in configurations]
        worst = 1e3 * max(np.linalg.norm(held.tip - target) for held, target in zip(rounded, CIRCLE, strict=True))
        assert worst < 0.05 if mode is ActuationMode.HYBRID else 2 < worst < 10

    def test_it_turns_by_symmetry(self, kang):
        """A third of a circle later the same forces act on the next actuators."""
        forces = np.array([c.forces for c in solve_trajectory(kang, circle(33).positions)]).reshape(33, 2, 3)
        np.testing.assert_allclose(np.roll(forces, 1, axis=2)[:22], forces[11:], atol=1e-5)

    def test_warm_equals_cold(self, kang, found):
        for configuration in found[1]:
            np.testing.assert_allclose(solve_ik(kang, configuration.target, found[0]).forces, configuration.forces, atol=1e-6)

    def test_the_paper_frame_needs_pull(self, kang):
        """SPEC section 1: with the base at 0 the circle needs -7.3 N; here, the circle 50 mm lower."""
        lower = solve_trajectory(kang, CIRCLE - [0, 0, 0.05], ActuationMode.HYBRID)
        assert not all(c.solved for c in lower)
        assert any("tension" in limit and "maximum" in limit for c in lower for limit in c.limits)


@pytest.mark.parametrize("mode", MODES)
def test_known_configurations_are_found_again(kang, cloud, mode):
    """Same tip, same forces: the configuration is unique."""
    for known in cloud[mode][:250]:
        found = solve_ik(kang, known.held.tip, mode)
        assert found.solved
        np.testing.assert_allclose(found.forces, known.forces, rtol=0, atol=1e-5)


def check_targets(kang, cloud, mode, targets) -> int:
    """Solved, or the nearest reachable point with the limits that stop it: no known configuration is nearer. How many are solved."""
    tips = np.array([known.held.tip for known in cloud[mode]])
    low, high = force_range(kang, mode)
    solved = 0
    for target in targets:
        found = solve_ik(kang, target, mode)
        if found.solved:
            check_held(kang, found)
            solved += 1
            continue
        assert found.outcome.ending is Ending.OUT_OF_REACH
        assert found.limits
        assert f"misses by {1e3 * found.miss:.2f} mm" in found.outcome.message
        assert all(limit in found.outcome.message for limit in found.limits)
        assert (found.forces >= low - 1e-9).all()
        assert (found.forces <= high + 1e-9).all()
        held = solve_statics(kang, found.allocation.inputs)
        assert np.linalg.norm(held.tip - target) == pytest.approx(found.miss, abs=1e-6)
        assert abs(held.lengths[1] - held.lengths[0]).max() < 1e-6
        assert np.linalg.norm(tips - target, axis=1).min() > found.miss - 1e-6
    return solved


def random_targets(count, low, high):
    return np.random.default_rng(1).uniform(low, high, (count, 3))


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES)
def test_100_random_targets(kang, cloud, mode):
    """In a box four times as large as what can be reached."""
    assert 5 <= check_targets(kang, cloud, mode, random_targets(100, [-0.3, -0.3, 0.1], [0.3, 0.3, 0.5])) <= 30


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES)
def test_1000_random_targets(kang, cloud, mode):
    assert 100 <= check_targets(kang, cloud, mode, random_targets(1000, [-0.3, -0.3, 0.1], [0.3, 0.3, 0.5])) <= 300


@pytest.mark.parametrize("mode", MODES)
def test_targets_about_the_axis_below_the_base(kang, cloud, mode):
    """The straight robot is the nearest there only among its neighbours: bent down it comes much nearer."""
    assert check_targets(kang, cloud, mode, random_targets(20, [-0.02, -0.02, -0.3], [0.02, 0.02, 0.0])) == 0
    assert solve_ik(kang, [0, 0, -0.05], mode).limits


class TestTrajectory:
    """More points than one call of the backend makes."""

    def test_each_point_starts_from_the_last_one_solved(self, kang):
        targets = circle(100).positions.copy()
        targets[[0, 40, 41, 70]] += [0.0, 0.0, 0.5]  # out of reach
        last = None
        for found, target in zip(solve_trajectory(kang, targets), targets, strict=True):
            alone = solve_ik(kang, target, start=last)
            np.testing.assert_array_equal(found.forces, alone.forces)
            np.testing.assert_array_equal(found.allocation.inputs, alone.allocation.inputs)
            assert (found.steps, found.outcome, found.limits) == (alone.steps, alone.outcome, alone.limits)
            last = found if found.solved else last
        assert last is not None

    def test_points_come_before_all_are_solved(self, kang):
        """A caller that stops, or is stopped, keeps what there is."""
        many = each_configuration(kang, np.repeat(CIRCLE, 1000, axis=0))
        assert [next(many).solved for _ in range(3)] == [True] * 3

    def test_threads_do_not_disturb_each_other(self, kang):
        """Problems of two modes and loads, mixed: what a thread has copied to C is of its last one."""
        asked = [(target, MODES[k % 2], [0.0, 0.05 * (k % 3), 0.0]) for k, target in enumerate(np.tile(CIRCLE, (4, 1)))]
        with ThreadPoolExecutor(4) as pool:
            together = [found.forces for found in pool.map(lambda one: solve_ik(kang, *one), asked)]
        np.testing.assert_array_equal(together, [solve_ik(kang, *one).forces for one in asked])

    @pytest.mark.slow
    def test_python_finds_the_same(self, kang, kang_python, compiler):
        for mode in MODES:
            for found, expected in zip(*(solve_trajectory(m, CIRCLE[:4], mode) for m in (kang, kang_python)), strict=True):
                np.testing.assert_allclose(found.forces, expected.forces, rtol=1e-9)
                np.testing.assert_allclose(found.allocation.inputs, expected.allocation.inputs, rtol=1e-9, atol=1e-9)
                assert found.steps == expected.steps


class TestOutOfReach:
    @pytest.mark.sample(3)
    @pytest.mark.parametrize("mode", MODES)
    @pytest.mark.parametrize("target", [(0.2, 0.1, 0.42), (-0.1, 0.2, 0.2), (0.0, -0.28, 0.3), (0.05, 0.0, 0.45)])
    def test_no_step_within_the_limits_comes_nearer(self, kang, mode, target):
        """Brute force: the first module's forces changed a little at random, the second's made to follow."""
        found = solve_ik(kang, target, mode)
        low, high = force_range(kang, mode)
        assert not found.solved
        tried = 0
        for size in (1.0, 0.1, 0.01):
            for change in size * random_directions(60, 2):
                near = equal_curvature(kang, np.clip(found.forces[:3] + change, low[:3], high[:3]))
                if near and (near.forces >= low - 1e-9).all() and (near.forces <= high + 1e-9).all():
                    tried += 1
                    assert np.linalg.norm(near.held.tip - target) > found.miss - 1e-6
        assert tried > 20

    @pytest.mark.parametrize(("mode", "highest"), [(ActuationMode.PRESSURE, 0.5e6), (ActuationMode.HYBRID, 111 * 4.5e3)])
    def test_two_metres_up(self, kang, mode, highest):
        """Straight up at full pressure: equal lengths leave the upper module, which carries less, below its limit."""
        found = solve_ik(kang, [0, 0, 2.0], mode)
        assert found.outcome.ending is Ending.OUT_OF_REACH
        assert found.limits == tuple(f"pressure_1{j} at its maximum" for j in (1, 2, 3))
        np.testing.assert_allclose(found.forces[:3], highest * AREA, atol=1e-6)
        straight = equal_curvature(kang, np.full(3, highest * AREA)).held
        assert found.miss == pytest.approx(2.0 - straight.tip[2], abs=1e-6)

    def test_pressure_alone_cannot_pull(self, kang):
        """A point that needs a negative force: reported as the pressure at 0, and reached with tension."""
        target = [-0.028, -0.22, 0.261]
        pressure, hybrid = (solve_ik(kang, target, mode) for mode in MODES)
        assert pressure.outcome.ending is Ending.OUT_OF_REACH
        assert all(limit.startswith("pressure_") and limit.endswith(" at 0") for limit in pressure.limits)
        assert pressure.miss > 0.01
        assert hybrid.solved
        assert hybrid.forces.min() < -0.1
        names = kang.layout.actuator_names
        assert names[int(hybrid.forces.argmin())] in {limit.split()[0].removeprefix("pressure_") for limit in pressure.limits}

    @pytest.mark.slow
    def test_a_robot_that_does_not_stand(self):
        """Three modules buckle under their weight: stable configurations lie in regions of their own, away from rest."""
        model = compile_model(variant(geometry={"modules": 3, "segments_per_module": 4}))
        assert not solve_statics(model, np.zeros(18)).solved
        for target, known in (([0.11, -0.184, 0.025], 0.23), ([0.348, 0.253, 0.002], 0.05), ([-0.16, -0.062, 0.017], 0.3)):
            found = solve_ik(model, target)
            assert found.outcome.ending is Ending.OUT_OF_REACH
            assert found.equilibrium.solved
            assert found.miss < known
            assert abs(found.equilibrium.lengths - found.equilibrium.lengths[0]).max() < 1e-6

    def test_the_rest_of_a_trajectory_is_solved(self, kang):
        targets = CIRCLE.copy()
        targets[[3, 4, 20]] = [[0, 0, 2.0], [0.5, 0.5, 0.2], [0, 0, -1.0]]
        found = solve_trajectory(kang, targets)
        assert [k for k, c in enumerate(found) if not c.solved] == [3, 4, 20]
        for k in set(range(32)) - {3, 4, 20}:
            check_held(kang, found[k])

    @pytest.mark.parametrize("mode", MODES)
    def test_a_target_on_the_border_is_within(self, kang, cloud, mode):
        """The nearest point to an unreachable target is itself solved, or missed by less than a micrometre."""
        nearest = solve_ik(kang, [0.2, 0.1, 0.42], mode).equilibrium.tip
        assert solve_ik(kang, nearest, mode).miss < 1e-6


def test_known_loads(kang):
    for force in 0.3 * random_directions(5, 3):
        found = solve_ik(kang, CIRCLE[5], loads=force)
        assert found.solved
        check_held(kang, found, force)
        assert abs(found.forces - solve_ik(kang, CIRCLE[5]).forces).max() > 0.01
        (along,) = solve_trajectory(kang, CIRCLE[5:6], loads=force)
        np.testing.assert_array_equal(along.forces, found.forces)


class TestSettings:
    """On a target 36 mm from a configuration that is known."""

    @pytest.fixture
    def start(self, kang):
        return solve_ik(kang, [0.13, 0.0, 0.35])

    def test_steps_are_no_larger(self, kang, start):
        target, steps = [0.1, 0.02, 0.35], []
        for largest in (0.3, 1.0, 8.0):
            found = solve_ik(kang, target, start=start, settings=IkSettings(max_step=largest))
            assert found.solved
            assert found.steps >= abs(found.forces - start.forces).max() / largest
            steps.append(found.steps)
        assert steps == sorted(set(steps), reverse=True)

    def test_after_so_many_steps_the_slow_search_takes_over(self, kang, start):
        target = [0.1, 0.02, 0.35]
        free = solve_ik(kang, target, start=start)
        enough, few = (solve_ik(kang, target, start=start, settings=IkSettings(max_iterations=n)) for n in (free.steps + 1, 1))
        assert enough.steps == free.steps
        assert few.solved
        assert few.steps > free.steps
        np.testing.assert_allclose(few.forces, free.forces, atol=1e-5)

    def test_mid_tension_only_moves_the_set_points(self, kang, start):
        low = solve_ik(kang, start.target, mid_tension=1.0)
        np.testing.assert_allclose(low.forces, start.forces, atol=1e-6)
        assert (low.allocation.inputs[6:] < start.allocation.inputs[6:]).all()
        check_held(kang, low)


@pytest.mark.parametrize("mode", MODES)
def test_effects_are_made_up_for(mode):
    model = compile_model(in_company(pressure_dead_zone={"threshold": 2e4}, payload={"mass": 0.01}))
    for found in solve_trajectory(model, CIRCLE[::4], mode):
        assert found.solved
        check_held(model, found)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("take_up", [0.0, 5.0])
def test_set_points_hold_the_configuration_where_tendons_hang_loose(mode, take_up):
    """Half a newton of slack, of which a muscle that lengthens takes up some."""
    model = compile_model(in_company(tendon_slack={"tension": 0.5, "take_up": take_up}))
    for target, found in zip(CIRCLE[::4], solve_trajectory(model, CIRCLE[::4], mode), strict=True):
        assert found.solved
        held = solve_statics(model, found.allocation.inputs)
        assert np.linalg.norm(held.tip - target) < 1e-7
        assert np.ptp(held.lengths, axis=0).max() < 1e-7


def test_a_frame_moved_and_turned_moves_and_turns_the_targets(kang):
    """Base moved and turned about gravity: the same forces at the moved and turned target."""
    robot = variant(mount={"base_rotation_deg": (0.0, 0.0, 40.0), "base_position_m": (0.3, -0.2, 0.1)})
    model = compile_model(robot, backend="python")
    for target in CIRCLE[::11]:
        moved = robot.mount.rotation @ (target + np.array([0, 0, 0.05])) + [0.3, -0.2, 0.1]
        np.testing.assert_allclose(solve_ik(model, moved).forces, solve_ik(kang, target).forces, atol=1e-6)


@pytest.mark.parametrize("target", [[0, 0], [0, 0, np.nan], ["x", 0, 0]])
def test_wrong_targets_are_refused(kang, target):
    with pytest.raises(InputError, match="target: "):
        solve_ik(kang, target)
    with pytest.raises(InputError, match="targets: "):
        solve_trajectory(kang, [target])

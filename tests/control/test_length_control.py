"""The paper's two modes: the rule of the motors, limits, and what they reach on the bench and on the arm."""

import numpy as np
import pytest

from tepm_opt.control.baselines.length_control import HoldTask, LengthController, LengthSettings, LengthTarget, TendonUse, hold
from tepm_opt.control.baselines.pid import Gains
from tepm_opt.control.estimation.lengths import LengthEstimator
from tepm_opt.errors import InputError
from tepm_opt.hw.commands import check_command
from tepm_opt.hw.simulation.bench import BenchRig
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.models.robot import load_robot
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.kinematics.ik import solve_ik

ROBOT = load_robot("kang2017")
FORCES = np.full(6, 8.0)


def target(lengths) -> LengthTarget:
    return LengthTarget(np.broadcast_to(lengths, 6).astype(float), FORCES)


def test_mode_1_never_touches_a_tendon():
    controller = LengthController(ROBOT, TendonUse.FOLLOWS)
    for k in range(20):
        command = controller.command(0.01 * k, np.full(6, 0.21), target(0.21 + 0.001 * k))
        assert not command.enabled.any()
        assert not command.tensions.any()


def test_motors_are_on_while_the_error_is_small_with_hysteresis():
    """On below 3 mm, off only above 4 mm, each actuator for itself."""
    controller = LengthController(ROBOT, TendonUse.ADJUSTS)
    on = [
        bool(controller.command(0.0, np.full(6, 0.22), target(0.22 + error)).enabled[0]) for error in (5e-3, 3.5e-3, 2.9e-3, 3.5e-3, 4.1e-3)
    ]
    assert on == [False, False, True, True, False]
    mixed = LengthController(ROBOT).command(0.0, np.full(6, 0.22), target(0.22 + np.array([0, 5, 0, 5, 0, 5]) * 1e-3))
    assert mixed.enabled.tolist() == [True, False] * 3
    assert not mixed.tensions[~mixed.enabled].any()


def test_thresholds_of_the_motors_are_settings():
    """On below 1 mm, off above 6 mm."""
    controller = LengthController(ROBOT, settings=LengthSettings(enable_below=1e-3, disable_above=6e-3))
    errors = (1.5e-3, 0.9e-3, 5.9e-3, 6.1e-3)
    assert [bool(controller.command(0.0, np.full(6, 0.22), target(0.22 + e)).enabled[0]) for e in errors] == [False, True, True, False]


def test_tension_begins_at_its_middle_and_is_brought_back_into_its_band():
    """The held pressure is chosen for `mid_tension`; where that is outside the band it follows at `mid_ranging_rate`, up to its edge."""
    settings = LengthSettings(mid_tension=4.0, low_tension=1.0, high_tension=2.5, mid_ranging_rate=0.5)
    controller, tensions = LengthController(ROBOT, settings=settings), []
    for k in range(500):
        tensions.append(controller.command(0.01 * k, np.full(6, 0.22), target(0.22)).tensions[0])
    step = ROBOT.parameters.A * 4500
    assert tensions[0] == pytest.approx(4.0, abs=step)
    assert tensions[100] == pytest.approx(3.5, abs=step)
    assert tensions[-1] == pytest.approx(2.5, abs=step)
    low = LengthController(ROBOT, settings=LengthSettings(mid_tension=0.2, low_tension=1.0))
    assert [low.command(0.01 * k, np.full(6, 0.22), target(0.22)).tensions[0] for k in range(200)][-1] == pytest.approx(1.0, abs=step)


def test_gains_and_filter_are_settings():
    """Proportional gains of either actuation make the force; a slow filter sees little of a step."""
    gains = {"pressure_gains": Gains(100.0, 0.0, 0.0), "tension_gains": Gains(200.0, 0.0, 0.0)}
    for error, gain in ((5e-3, 100.0), (1e-3, 200.0)):
        command = LengthController(ROBOT, settings=LengthSettings(**gains)).command(0.0, np.full(6, 0.22), target(0.22 + error))
        assert ROBOT.parameters.A * command.pressures - command.tensions == pytest.approx(FORCES + gain * error)
    made = {}
    for time in (0.0, 1.0):
        controller = LengthController(ROBOT, TendonUse.FOLLOWS, LengthSettings(**gains, filter_time=time))
        controller.command(0.0, np.full(6, 0.22), target(0.22))
        command = controller.command(0.1, np.full(6, 0.21), target(0.22))
        made[time] = ROBOT.parameters.A * command.pressures - FORCES
    assert made[0.0] == pytest.approx(np.full(6, 1.0))
    assert made[1.0] == pytest.approx(np.full(6, 1 - np.exp(-0.1)))


def test_axial_force_is_the_feed_forward_at_the_target():
    """p A − λ is the model's force, whatever the motors do; held pressures are on the regulator's grid."""
    command = LengthController(ROBOT).command(0.0, np.full(6, 0.22), target(0.22))
    assert ROBOT.parameters.A * command.pressures - command.tensions == pytest.approx(FORCES)
    assert command.pressures / 4500 == pytest.approx(np.round(command.pressures / 4500))
    assert (command.tensions > 0.5).all()


@pytest.mark.parametrize("use", list(TendonUse))
def test_commands_stay_within_the_limits(use):
    """Whatever lengths come in, also none."""
    controller, random = LengthController(ROBOT, use), np.random.default_rng(2)
    for k in range(300):
        lengths = 0.22 + 0.05 * random.normal(size=6)
        lengths[random.random(6) < 0.2] = np.nan
        check_command(controller.command(0.01 * k, lengths, target(0.2 + 0.1 * random.random(6))), ROBOT)


def test_wrong_shapes_are_refused():
    with pytest.raises(InputError, match="shapes"):
        LengthController(ROBOT).command(0.0, np.zeros(5), target(0.2))


@pytest.mark.slow
@pytest.mark.parametrize("use", list(TendonUse))
def test_set_points_on_a_perfect_bench_are_reached(use):
    """No friction, no grid, no noise: within 0.1 mm in the end, in either mode, with a feed-forward 10 % too small."""
    rig = BenchRig("perfect")
    wanted = [LengthTarget(np.array([length]), np.array([0.9 * 358.86 * (length - 0.2)])) for length in (0.22, 0.23)]
    held = hold(rig, LengthController(rig.robot, use), lambda sample: sample.lengths, HoldTask(wanted, 6.0))
    late = held.time % 6 > 5.5
    assert np.abs(held.lengths[late, 0] - np.array([0.22, 0.23])[held.target[late]]).max() < 1e-4
    assert bool(held.enabled[late].all()) == (use is TendonUse.ADJUSTS)


@pytest.mark.parametrize("use", [pytest.param(TendonUse.FOLLOWS, marks=pytest.mark.slow), TendonUse.ADJUSTS])
def test_arm_comes_to_a_point_of_the_circle_and_stays(kang, use):
    """On the perfect rig, whose sway nothing damps: the tip within 3 mm of the target, all the last second long."""
    found = solve_ik(kang, [0.15, 0.0, 0.35], ActuationMode.PRESSURE)
    wanted = LengthTarget(found.equilibrium.lengths.ravel(), found.forces)
    estimator = LengthEstimator(kang)
    rig = SimulatedRig("perfect")
    held = hold(
        rig, LengthController(rig.robot, use), lambda sample: estimator.update(sample.points), HoldTask([wanted], 5.0, approach=3.0)
    )
    missed = np.linalg.norm(held.points[held.time > 7.0, -1] - found.target, axis=1)
    assert missed.max() < 3e-3

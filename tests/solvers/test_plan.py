"""Plans keep their limits and leave no sway: by exact equilibria, in the full network behind lag and delay, and on the rig."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import RigFile, load_rig_file
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.solvers.kinematics.ik import solve_ik
from tepm_opt.solvers.mechanics.simulate import simulate
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.solvers.planning.objective import Objective
from tepm_opt.solvers.planning.plan import PlanSettings, plan_move, plan_path
from tepm_opt.solvers.planning.program import Box, Sphere
from tepm_opt.solvers.planning.result import MotionPlan
from tepm_opt.solvers.planning.trajectories import circle, line
from tests.tools import in_company

START, END = (0.15, 0.0, 0.35), (0.05, 0.0, 0.35)  # 100 mm apart
STILL, WATCHED = 1e-3, 5.0  # m, s: what counts as no sway, and for how long after the reference has ended
FASTER = 2.5
PRESSURE_STEP, AREA, RADIUS = 4500.0, 50.27e-6, 0.02


@pytest.fixture(scope="module")
def fastest(kang: CompiledModel) -> MotionPlan:
    return plan_move(kang, START, END)


@pytest.fixture(scope="module")
def gentle(kang: CompiledModel) -> MotionPlan:
    return plan_move(kang, START, END, Objective.EFFORT, 1.5)


@pytest.fixture(scope="module")
def devices() -> CompiledModel:
    """The network behind the virtual prototype's regulators and delay."""
    lag = {"filling_time": 0.12, "exhausting_time": 0.24}
    return compile_model(in_company(regulator_lag=lag, time_delay={"delay": 0.005}))


def held_on(setpoints: SetPoints, seconds: float) -> SetPoints:
    """The same set points with the last ones held on."""
    time = setpoints.time[-1] + np.arange(1, round(seconds / 0.02) + 1) * 0.02
    inputs = np.vstack([setpoints.inputs, np.repeat(setpoints.inputs[-1:], len(time), axis=0)])
    return SetPoints(np.concatenate([setpoints.time, time]), inputs, np.zeros((len(inputs), 3)))


def left_over(time: np.ndarray, tips: np.ndarray, rest: np.ndarray, end: float) -> float:
    """Largest distance of the tip from where it comes to rest in the 5 s after the reference has ended, m."""
    watched = (time >= end - 1e-9) & (time <= end + WATCHED)
    return float(np.linalg.norm(tips[watched] - rest, axis=1).max())


def sway(model: CompiledModel, setpoints: SetPoints) -> float:
    """What the full network has left over, m."""
    motion = simulate(model, held_on(setpoints, WATCHED), error=1e-5)
    return left_over(motion.setpoints.time, motion.tip, solve_statics(model, setpoints.inputs[-1]).tip, setpoints.time[-1])


def ramp(model: CompiledModel, duration: float) -> SetPoints:
    """Linear set points between the configurations at both ends."""
    inputs = np.array([solve_ik(model, np.array(tip)).allocation.inputs for tip in (START, END)])
    return SetPoints(np.array([0.0, duration]), inputs, np.zeros((2, 3)))


def check_limits(plan: MotionPlan) -> None:
    inputs, half = plan.setpoints.inputs, plan.model.layout.inputs // 2
    assert plan.solved
    assert np.isfinite(inputs).all()
    assert inputs.min() >= 0
    assert (inputs <= plan.model.input_max).all()
    steps = np.diff(plan.time)
    assert steps.max() <= 0.02 + 1e-9
    assert (np.abs(np.diff(inputs[:, half:], axis=0)) <= 10.0 * steps[:, None]).all()
    grid = inputs[:, :half] / PRESSURE_STEP
    assert np.abs(grid - np.round(grid)).max() < 1e-9
    assert np.linalg.norm(np.diff(plan.tips, axis=0), axis=1)[[0, -1]].max() < 1e-3  # from rest to rest
    for row in (0, -1):
        held = solve_statics(plan.model, inputs[row])
        assert np.linalg.norm(held.tip - plan.tips[row]) < 1e-6


class TestMove:
    def test_keeps_all_limits(self, fastest: MotionPlan, gentle: MotionPlan) -> None:
        for plan in (fastest, gentle):
            check_limits(plan)
            np.testing.assert_allclose(plan.tips[[0, -1]], [START, END], atol=1e-6)
        assert gentle.duration == pytest.approx(1.5)

    def test_polynomials_are_the_configurations(self, fastest: MotionPlan) -> None:
        assert fastest.surrogate_error[0] < 5e-5
        assert fastest.surrogate_error[1] < 1e-3
        for row in (0, len(fastest.time) // 2, -1):
            found = solve_ik(fastest.model, fastest.tips[row]).equilibrium
            np.testing.assert_allclose(found.points, fastest.points[row], atol=1e-6)

    @pytest.mark.slow
    def test_leaves_no_sway_behind_lag_and_delay(self, devices: CompiledModel, fastest: MotionPlan, gentle: MotionPlan) -> None:
        assert sway(devices, fastest.setpoints) < STILL
        assert sway(devices, gentle.setpoints) < 0.5 * STILL

    @pytest.mark.slow
    def test_is_made_smoother_where_twist_would_be_left(self, kang: CompiledModel, devices: CompiledModel) -> None:
        """Around the axis, far out: no force of the actuators holds the twist, so it must not be driven fast."""
        plan = plan_move(kang, (-0.044, 0.142, 0.359), (0.032, 0.163, 0.352))
        check_limits(plan)
        assert plan.residual_sway < 8e-4
        assert sway(devices, plan.setpoints) < STILL

    @pytest.mark.slow
    def test_is_much_faster_than_ramps(self, devices: CompiledModel, fastest: MotionPlan) -> None:
        """No ramp up to ten times its duration leaves as little, not even on regulators without a grid."""
        assert fastest.duration < 0.6
        assert min(sway(devices, ramp(devices, part * fastest.duration)) for part in np.arange(1.0, 10.5, 0.5)) > STILL

    def test_least_effort_is_less(self, fastest: MotionPlan, gentle: MotionPlan) -> None:
        assert gentle.effort < 0.2 * fastest.effort

    @pytest.mark.slow
    def test_doubt_makes_it_robust(self, kang: CompiledModel, devices: CompiledModel, fastest: MotionPlan) -> None:
        """Against an arm with muscles 3 % softer, which near buckling changes its frequencies by more."""
        trusting, doubting = fastest, plan_move(kang, START, END, settings=PlanSettings(frequency_uncertainty=0.1, max_sway=5e-4))
        check_limits(doubting)
        softer = devices.with_theta(np.where([name == "K_a" for name in devices.network.parameter_names], 0.97, 1.0) * devices.theta)
        assert sway(softer, doubting.setpoints) < 0.5 * sway(softer, trusting.setpoints)

    @pytest.mark.slow
    def test_margin_is_kept(self, kang: CompiledModel) -> None:
        ends = [solve_ik(kang, np.array(tip)).equilibrium.smallest_eigenvalue for tip in (START, END)]
        margin = min(ends) - 1e-3
        plan = plan_move(kang, START, END, settings=PlanSettings(min_stiffness=margin))
        check_limits(plan)
        assert plan.margin > margin - 1e-4
        impossible = plan_move(kang, START, END, settings=PlanSettings(min_stiffness=max(ends)))
        assert impossible.outcome.ending is Ending.BLOCKED
        assert impossible.outcome.message.startswith("start: its smallest stiffness eigenvalue is 0.29")


class TestObstacles:
    @pytest.mark.slow
    @pytest.mark.parametrize("kind", ["sphere", pytest.param("box", marks=pytest.mark.slow)])
    def test_all_points_stay_clear(self, kang: CompiledModel, kind: str) -> None:
        centre = np.array([0.1, 0.004, 0.352])
        obstacle = Sphere(tuple(centre), RADIUS) if kind == "sphere" else Box(tuple(centre - RADIUS), tuple(centre + RADIUS))
        plan = plan_move(kang, START, END, obstacles=[obstacle])
        check_limits(plan)
        fine = np.linspace(0, plan.duration, 8 * len(plan.time))
        for k in range(4):
            way = np.stack([np.interp(fine, plan.time, plan.points[:, k, axis]) for axis in range(3)], axis=1) - centre
            away = np.linalg.norm(way, axis=1) if kind == "sphere" else np.abs(way).max(axis=1)
            assert away.min() > RADIUS

    @pytest.mark.slow
    def test_elsewhere_they_cost_nothing(self, kang: CompiledModel, fastest: MotionPlan) -> None:
        plan = plan_move(kang, START, END, obstacles=[Sphere((-0.2, 0.0, 0.3), 0.05)])
        assert plan.duration == pytest.approx(fastest.duration, rel=1e-3)

    def test_a_goal_inside_is_refused(self, kang: CompiledModel) -> None:
        plan = plan_move(kang, START, END, obstacles=[Sphere(END, RADIUS)])
        assert plan.outcome.ending is Ending.BLOCKED
        assert plan.outcome.message == "end: s4 is 20.0 mm inside obstacle 1; valid: at least 2 mm away"
        assert len(plan.time) == len(plan.setpoints.inputs) == 0

    def test_clearance_is_a_setting(self, kang: CompiledModel) -> None:
        near = Sphere((END[0], 0.0, END[2] + RADIUS + 4e-3), RADIUS)
        plan = plan_move(kang, START, END, obstacles=[near], settings=PlanSettings(clearance=0.005))
        assert plan.outcome == Outcome(Ending.BLOCKED, "end: s4 is 4.0 mm from obstacle 1; valid: at least 5 mm away")


class TestPath:
    @pytest.mark.slow
    def test_keeps_to_it(self, kang: CompiledModel, devices: CompiledModel) -> None:
        plan = plan_path(kang, line(start=START, end=END))
        check_limits(plan)
        assert np.abs(plan.tips[:, 1:] - START[1:]).max() < 1e-5
        assert (np.diff(plan.tips[:, 0]) <= 1e-6).all()
        assert sway(devices, plan.setpoints) < STILL

    @pytest.mark.slow
    def test_circle(self, kang: CompiledModel, devices: CompiledModel) -> None:
        plan = plan_path(kang, circle())
        check_limits(plan)
        assert np.abs(np.linalg.norm(plan.tips[:, :2], axis=1) - 0.15).max() < 1e-5
        assert plan.duration < 3.0
        assert sway(devices, plan.setpoints) < STILL


class TestWrongUse:
    def test_out_of_reach(self, kang: CompiledModel) -> None:
        plan = plan_move(kang, START, (0.05, 0.0, 0.65))
        assert plan.outcome.ending is Ending.OUT_OF_REACH
        assert plan.outcome.message.startswith("(0.05, 0, 0.65): out of reach: the nearest point misses by")

    @pytest.mark.slow
    def test_too_short(self, kang: CompiledModel, fastest: MotionPlan) -> None:
        plan = plan_move(kang, START, END, Objective.EFFORT, 0.2, settings=PlanSettings(max_iterations=60))
        assert plan.outcome.ending is Ending.NO_PLAN
        assert plan.outcome.message.endswith(f"; the fastest plan takes {fastest.duration:.2f} s")

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"end": START}, "is the start; valid: another place"),
            ({"end": (np.nan, 0, 0)}, "end"),
            ({"duration": 1.0}, "valid: seconds for objective 'effort', none for 'time'"),
            ({"objective": Objective.EFFORT}, "valid: seconds for objective 'effort'"),
            ({"objective": Objective.EFFORT, "duration": -1.0}, r"duration: -1 s; valid: 0\.05 … 600 s"),
            ({"settings": PlanSettings(mid_tension=7.0)}, r"mid_tension: 7 N; valid: 0\.3 … 6\.7 N"),
        ],
    )
    def test_arguments(self, kang: CompiledModel, change: dict, message: str) -> None:
        with pytest.raises(InputError, match=message):
            plan_move(kang, **{"start": START, "end": END, **change})

    def test_paths(self, kang: CompiledModel) -> None:
        with pytest.raises(InputError, match="trajectory: 3 points; valid: at least 6"):
            plan_path(kang, line(points=3))
        path = line(points=8, start=START, end=END)
        with pytest.raises(InputError, match="each but a closing one other than the last"):
            plan_path(kang, replace(path, positions=path.positions[[0, 0, 1, 2, 3, 4, 5, 6]]))


def on_rig(file: RigFile, setpoints: SetPoints, settle: float = 12.0) -> float:
    """What the true tip has left over on a simulated rig, m; it rests where it is on average in the last of `settle` s."""
    rig, end = SimulatedRig(file), float(setpoints.time[-1])
    rig.schedule(setpoints)
    time, tips = [], []
    while not time or time[-1] < end + settle:
        time.append(rig.read().time)
        tips.append(rig.true_points[-1].copy())
    rest = np.mean(np.array(tips)[np.array(time) > end + settle - 2.0], axis=0)
    return left_over(np.array(time), np.array(tips), rest, end)


def devices_only(file: RigFile) -> RigFile:
    """The virtual prototype's devices on the nominal robot: no friction, no errors of parameters."""
    kept = file.imperfections.model_dump(include={"time_delay", "regulator_lag"})
    return RigFile.model_validate({**file.model_dump(), "name": "its devices alone", "imperfections": kept, "parameter_factors": {}})


@pytest.mark.slow
class TestOnTheRig:
    """Played open loop. The rig's regulators go in steps of 4.5 kPa, a kick of 2 to 3 mm each that a ramp does not make up for."""

    def compare(self, file: RigFile, plan: MotionPlan) -> None:
        check_limits(plan)
        left = on_rig(file, plan.setpoints)
        ramps = {part: on_rig(file, ramp(plan.model, part * plan.duration)) for part in (1.0, 1.5, 2.0, FASTER)}
        told = ", ".join(f"{part * plan.duration:.2f} s {1e3 * value:.2f} mm" for part, value in ramps.items())
        print(f"\n{file.name}: plan {plan.duration:.2f} s {1e3 * left:.2f} mm; ramps {told}")
        assert left < STILL
        assert min(ramps.values()) > STILL

    def test_its_devices_on_the_nominal_robot(self, fastest: MotionPlan) -> None:
        self.compare(devices_only(load_rig_file()), fastest)

    def test_virtual_prototype(self, kang: CompiledModel) -> None:
        """With friction nobody knows of the fastest plan creeps and sways; the gentle one of 4 s does not, and ramps do for long."""
        self.compare(load_rig_file(), plan_move(kang, START, END, Objective.EFFORT, 4.0))

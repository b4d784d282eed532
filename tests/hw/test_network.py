"""The rig's network is SPEC's: reference runs, check values, hand calculations."""

import numpy as np
import pytest

from tepm_opt.data.run import Run, read_run
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Command
from tepm_opt.hw.simulation import machine
from tepm_opt.hw.simulation.equilibrium import NoEquilibriumError, find_equilibrium
from tepm_opt.hw.simulation.imperfections.base import Body
from tepm_opt.hw.simulation.machine import Diverged
from tests.hw.rigs import AREA, DAMPING, LENGTH, STIFFNESS, bar, inputs, ramps, read_until, resting, rig_of, robot_file
from tests.paths import reference

RUNS = ("circle", "elongation", "mixed", "single_pressure", "single_tension", "steps", "tip_load")
FIRST = (2.0, 1.5, 3.0, 1.5, 1.5, 3.0, 1.5)  # s of each run in the quick test; the inputs begin to move 0.5 … 1 s before


def miss(run: Run, until: float) -> float:
    """RMS in m over all coordinates of a perfect rig against a run up to a time in s."""
    rig = rig_of(tracker={"rate_hz": 50})
    rig.schedule(SetPoints(run.time, run.inputs, run.tip_force))
    samples = read_until(rig, min(until, run.duration))
    assert [sample.time for sample in samples] == pytest.approx(run.time[: len(samples)], abs=1e-9)
    error = np.array([sample.points for sample in samples]) - run.points[: len(samples)]
    return float(np.sqrt(np.mean(error**2)))


@pytest.mark.parametrize(("name", "until"), list(zip(RUNS, FIRST, strict=True)), ids=RUNS)
def test_reference_runs_begin_the_same(name, until):
    assert miss(read_run(reference(f"null/{name}.csv")), until) < 1e-7  # the files have nine decimals


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_reference_runs(name):
    assert miss(read_run(reference(f"null/{name}.csv")), np.inf) < 1e-7


def test_check_values_of_statics():
    """SPEC section 2: no input; two pressures; 2.5 N along x with 63.21° of tilt. Base frame: G is 50 mm above it."""
    rig = rig_of()
    assert rig.true_points[-1] == pytest.approx([0, 0, 0.396814 - 0.05], abs=1e-6)
    rig.apply(Command.from_inputs(inputs(rig, [0.2e6] * 3 + [0.3e6] * 3)))
    assert rig.true_points[-1] == pytest.approx([0, 0, 0.446164 - 0.05], abs=1e-6)
    rig.apply(Command.from_inputs(inputs(rig)))
    rig.push(np.array([2.5, 0, 0]))
    assert rig.true_points[-1] == pytest.approx([0.27210, 0.00850, 0.26514 - 0.05], abs=1e-5)
    top = rig.true_nodes[-1]
    normal = np.cross(top[1] - top[0], top[2] - top[0])
    assert np.degrees(np.arccos(abs(normal[2]) / np.linalg.norm(normal))) == pytest.approx(63.21, abs=0.01)


def test_sway_of_the_free_arm():
    """SPEC section 2: −0.245 ± 5.642j at rest, seen in the decay after a small side force is taken away."""
    rig = rig_of()
    rig.push(np.array([0.002, 0, 0]))
    rig.read()
    rig.push(np.zeros(3))
    samples = read_until(rig, 4.0)
    time = np.array([sample.time for sample in samples])
    side = np.array([sample.points[-1, 0] for sample in samples])
    late = time > 0.5
    basis = [np.exp(-0.245 * time[late]) * wave(5.642 * time[late]) for wave in (np.cos, np.sin)]
    left = np.linalg.lstsq(np.stack(basis, axis=1), side[late], rcond=None)[1]
    assert np.sqrt(left[0] / late.sum()) < 0.005 * np.abs(side[late]).max()


def test_free_actuators_elongate_by_p_a_over_k():
    """Paper III.B: 0 … 0.5 MPa gives 0 … 70 mm; a tension of λ takes λ / K_a away."""
    assert resting(bar(), 0.5e6) - LENGTH == pytest.approx(np.full(3, 0.5e6 * AREA / STIFFNESS), rel=2e-3)
    lengths = resting(bar(), [0.3e6, 0.2e6, 0.1e6], [0, 1, 2])
    assert lengths - LENGTH == pytest.approx((np.array([0.3e6, 0.2e6, 0.1e6]) * AREA - [0, 1, 2]) / STIFFNESS, abs=1e-4)


def test_ramp_of_a_free_actuator():
    """K_a ΔL + c_a dL/dt = p A: behind a slow ramp by c_a times the rate; inputs are linear between samples."""
    rig = bar()
    ramps(rig, [0, 4], [0, 0.4e6])
    read_until(rig, 3.0)
    rate = 0.1e6 * AREA / STIFFNESS
    assert rig.true_lengths - LENGTH == pytest.approx(np.full(3, 3 * rate - DAMPING * rate / STIFFNESS), rel=1e-3)


@pytest.mark.parametrize(
    "mount", [{"base_rotation_deg": (0, 30, 0), "base_position_m": (0.1, 0.2, 0.3)}, {"base_rotation_deg": (0, 0, 90)}]
)
def test_mounting_turns_gravity_and_points(mount):
    """A turned base sees gravity obliquely; without gravity the shape itself is turned with it."""
    light = rig_of(robot_file(gravity_m_per_s2=(0, 0, 0), **mount))
    rotation, shift = light.robot.mount.rotation, np.array(light.robot.mount.base_position_m)
    assert light.true_points == pytest.approx(shift + np.outer([0.1, 0.2, 0.3, 0.4], rotation[:, 2]), abs=1e-9)
    assert Body.from_robot(rig_of(robot_file(**mount)).robot).gravity == pytest.approx(rotation.T @ [0, 0, -9.81])


@pytest.mark.parametrize("changes", [
    {"modules": 1, "segments_per_module": 3},
    {"modules": 3, "segments_per_module": 2, "actuator_angles_deg": (45, 135, 225, 315)},
    {"modules": 1, "segments_per_module": 2, "bracing": '"single"'},
])  # fmt: skip
def test_other_robots(changes):
    """Weights and potential of any robot: the mean height under gravity follows from the springs' total stiffness at small loads."""
    rig = rig_of(robot_file(gravity_m_per_s2=(0, 0, 0), **changes))
    robot = rig.robot
    heights = rig.robot.parameters.L_0 * np.arange(1, 2 * robot.modules + 1) / 2 - 0.05
    assert rig.true_points[:, 2] == pytest.approx(heights, abs=1e-9)
    body = Body.from_robot(robot)
    assert body.mass.sum() == pytest.approx(robot.modules * robot.parameters.m_d)
    resting(rig, 0.1e6)
    assert (rig.true_lengths > robot.parameters.L_0 + 0.001).all()


def test_forces_on_points_are_shared_by_their_nodes():
    """A pull on the end of the bar and one at its half height: F / 3 K_a and F / 6 K_a."""
    rig = bar()
    rig.push(np.array([[0, 0, 1.0], [0, 0, 2.0]]))
    lengths = rig.true_lengths - LENGTH
    assert lengths == pytest.approx(np.full(3, 2 / (3 * STIFFNESS) + 1 / (6 * STIFFNESS)), rel=2e-3)


def test_settle_avoids_saddles_and_says_when_there_is_no_rest():
    """A double well started on its hill; a force that nothing holds."""
    well = find_equilibrium(lambda x: x - x**3 / 1e-4, np.zeros(1))
    assert abs(well[0]) == pytest.approx(1e-2, rel=1e-6)
    with pytest.raises(NoEquilibriumError, match="does not come to rest"):
        find_equilibrium(np.ones_like, np.zeros(1), iterations=20)


@pytest.mark.parametrize("engine", ["auto", "mujoco"])
def test_divergence_is_said(tmp_path, monkeypatch, engine):
    """A network that is too stiff for the step blows up with a message; neither engine restarts or hides it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(machine, "longest_step", lambda body: 1.0)
    rig = rig_of(parameter_factors={"K_a": 5.0, "c_a": 5.0}, simulation={"engine": engine})
    rig.apply(Command.from_inputs(inputs(rig)))
    rig.read()
    rig.apply(Command.from_inputs(inputs(rig, [1e5, 0, 0, 0, 0, 0])))
    with pytest.raises(Diverged, match=r"before .* s in steps of 0.00025 s .*try 0.00013 in a rig file"):
        read_until(rig, 1.0)
    assert list(tmp_path.iterdir()) == []  # no MUJOCO_LOG.TXT


def test_forces_are_refused_when_wrong():
    rig = rig_of()
    for wrong in (np.array([np.nan, 0, 0]), np.zeros(2), np.zeros((3, 3))):
        with pytest.raises(InputError, match=r"valid: finite numbers of the shape \(4, 3\)"):
            rig.push(wrong)

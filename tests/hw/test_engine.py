"""The compiled engine: closed forms, the Python stages it stands for, MuJoCo, and what happens where it cannot run."""

from __future__ import annotations

import subprocess
import sys
from functools import partialmethod
from typing import Any

import numpy as np
import pytest

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.hw.registry import open_rig
from tepm_opt.hw.rig import Command
from tepm_opt.hw.simulation import engine, machine
from tepm_opt.hw.simulation.compiled_machine import CompiledMachine
from tepm_opt.hw.simulation.imperfections import Imperfections
from tepm_opt.hw.simulation.imperfections.base import Body, Numbers, StaticMap
from tepm_opt.hw.simulation.imperfections.pressure import PressureDeadZone
from tepm_opt.hw.simulation.mujoco_machine import MujocoMachine
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import RigFile, load_rig_file
from tepm_opt.hw.simulation.stability import longest_step
from tepm_opt.hw.simulation.timeline import Timeline
from tepm_opt.models.backends import compiler as c_compiler
from tepm_opt.models.backends import store
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import load_robot
from tests.hw.rigs import BAR, bar, inputs, ramps, read_until, rig_of, robot_file

pytestmark = pytest.mark.usefixtures("compiler")

SMOOTH: dict[str, dict[str, Any]] = {
    "nothing": {},
    "time_delay": {"delay_s": 0.01325},
    "payload": {"mass_kg": 0.05, "eccentricity_m": [0.01, -0.005]},
    "mass_distribution": {"fraction": 0.3, "holder_share": 0.3},
    "uneven_mass": {"fraction": 0.1, "toward_deg": 40, "scatter": 0.1},
    "rigid_plates": {"clamped_length_m": 0.006},
    "soft_part": {"loss": 0.3, "first": 2, "last": 2},
    "twisted_body": {"strain": 0.02},
    "base_tilt": {"rotation_deg": [1.0, -2.0]},
    "external_load": {"force_N": [0.2, -0.1, 0.3]},
    "tethered_tip": {"stiffness_N_per_m": 2.0, "place_m": [0.1, 0.0, 0.3]},
    "tip_drag": {"size_N_s2_per_m2": 2.0},
    "stiffness_hardening": {"growth": 1.5},
    "creep": {"fraction": 0.2},
    "pressure_dead_zone": {"threshold_Pa": 2e4},
    "pressure_crosstalk": {"share": 0.1},
    "actuator_gain": {"loss": {"12": 0.05, "23": -0.04}},
    "actuator_offset": {"length_m": {"12": 0.003}, "zero_Pa": {"23": -2e3}},
    "actuator_scatter": {"area_spread": 0.03, "length_spread_m": 1e-3, "draw": 4},
    "tension_gain": {"loss": {"21": 0.1}, "zero_N": {"12": -0.2}, "bend": 0.05},
    "sensor_offset": {"offset_m": {"s3": [0.004, 0, 0.001]}},
    "field_distortion": {"size_m": 0.01},
    "sensor_misalignment": {"rotation_deg": [1, 2, 3], "shift_m": [0.01, 0, 0]},
    "warm_up": {"change": -0.2, "full_s": 1.0},
    "tendon_slip": {"share": {"12": 0.3}, "instant_s": 0.1},
    "tracker_drift": {"shift_m": [0.01, 0, 0], "rotation_deg": [1, 0, 0], "period_s": 10.0},
    "base_vibration": {"amplitude_m": [1e-3, 0, 5e-4], "phase_deg": 40.0},
    "clock_skew": {"rate": 0.01, "bend_per_s": -1e-4},
    "sample_jitter": {"up_to_s": 4e-3},
}
ROUGH: dict[str, dict[str, Any]] = {
    "regulator_lag": {"fill_s": 0.12, "exhaust_s": 0.24},
    "choked_filling": {"rate_per_s": 0.5},
    "regulator_leak": {"share": {"13": 0.05}},
    "pressure_hysteresis": {"width_Pa": 2e4, "operators": 5, "asymmetry": 0.3},
    "tip_wall": {"stiffness_N_per_m": 200.0, "place_m": [0.002, 0.0, 0.3], "normal": [-1, 0.2, 0]},
    "tendon_slack": {"length_m": 0.004},
    "tendon_friction": {"constant_N": 0.05, "share": 0.2},
    "structural_friction": {"sliding_N": 0.3, "share": 0.05, "breakaway_ratio": 1.5},
}
DEVICES = {
    "regulator": {"quantised": True},
    "stepper": {"quantised": True, "rate_limit_N_per_s": 10.0},
    "pressure_monitor": {"fitted": True, "noise_rms_Pa": 500.0},
    "dynamometer": {"fitted": True, "noise_rms_N": 0.01, "offset_N": 0.05},
    "tracker": {"rate_hz": 100, "latency_s": 0.015, "noise_rms_m": 1e-3, "dropout_probability": 0.02, "dropout_frames": 3},
}
EVERYTHING = {name: sizes for name, sizes in (SMOOTH | ROUGH).items() if sizes}
OTHERS = {
    "another": {"modules": 3, "segments_per_module": 2, "actuator_angles_deg": (45, 135, 225, 315)},
    "bar": BAR,
    "single bracing": {"modules": 1, "segments_per_module": 5, "bracing": '"single"', "base_rotation_deg": (0, 30, 0)},
}
"""Robots whose levels do not fill whole vectors."""
BY_PART = ("actuator_gain", "actuator_offset", "tendon_slip", "tension_gain", "regulator_leak", "sensor_offset", "structural_friction")
"""Imperfections whose sizes name parts that other robots do not have, and one whose sizes they do not bear."""
SHORT = {"segments_per_module": 3}  # for MuJoCo's sake


def rig_file(engine: str, robot: str = "kang2017", imperfections: dict[str, Any] | None = None, **sections: Any) -> RigFile:
    """A rig of an engine."""
    made = {"name": "test", "robot": robot, "seed": 5, "simulation": {"engine": engine}, "imperfections": imperfections or {}}
    return RigFile.model_validate({**made, **sections})


def driven(rig: SimulatedRig, seconds: float, seed: int = 1) -> SimulatedRig:
    """A rig that follows drawn set points with drawn pushes at the tip, linear between some and with a jump."""
    random, count = np.random.default_rng(seed), rig.layout.inputs // 2
    times = np.arange(0.0, seconds + 0.4, 0.2)
    rows = np.column_stack([random.uniform(0, 1.2e5, (len(times), count)), random.uniform(0, 2, (len(times), count))])
    rig.schedule(SetPoints(times, rows, random.normal(size=(len(times), 3)) * 0.1))
    return rig


def seen(rig: SimulatedRig, seconds: float) -> np.ndarray:
    """What a rig truly does, all nodes at all frames, (frames, n + 1, actuators, 3) in m."""
    places = []
    while rig.time < seconds:
        rig.read()
        places.append(rig.true_nodes)
    return np.array(places)


def apart(seconds: float, robot: str = "kang2017", seed: int = 1, **sections: Any) -> float:
    """RMS distance in m of all nodes over all frames between the engines."""
    both = [seen(driven(SimulatedRig(rig_file(each, robot, **sections)), seconds, seed), seconds) for each in ("compiled", "mujoco")]
    assert np.ptp(both[1][:, -1], axis=0).max() > 1e-3  # it moves
    return float(np.sqrt(np.mean(np.sum((both[0] - both[1]) ** 2, axis=-1))))


def test_every_imperfection_is_tried():
    assert set(SMOOTH | ROUGH) - {"nothing"} == set(Imperfections.model_fields)


@pytest.mark.sample(3)
@pytest.mark.parametrize("name", SMOOTH | ROUGH)
def test_an_imperfection_is_the_same_on_both_engines(name):
    """To rounding, over a short time: the Python stages with MuJoCo against both in C."""
    sizes = (SMOOTH | ROUGH)[name]
    assert apart(0.25, robot_file(**SHORT), imperfections={name: sizes} if sizes else {}) < 1e-11


@pytest.mark.slow
@pytest.mark.parametrize("changes", OTHERS.values(), ids=list(OTHERS))
def test_everything_on_another_robot_is_the_same_on_both_engines(changes):
    """To rounding: or to what a last digit in one parameter makes of the same engine, where a set point lies between two steps of a motor
    and rounding, which processors do differently, decides which one it takes."""
    kept = {name: sizes for name, sizes in EVERYTHING.items() if name not in BY_PART}
    sections = {"imperfections": kept | {"structural_friction": {"sliding_N": 0.3}}, **DEVICES}
    file = rig_file("compiled", robot_file(**changes), **sections)

    def nudged(digits: int) -> np.ndarray:
        stiffness = file.parameter_factors.get("K_a", 1.0) * (1 + digits * np.finfo(float).eps)
        return seen(
            driven(SimulatedRig(file.model_copy(update={"parameter_factors": {**file.parameter_factors, "K_a": stiffness}})), 0.2, 1), 0.2
        )

    still, *moved = (nudged(digits) for digits in (0, 1, 5, 18))
    own = max(float(np.sqrt(np.mean(np.sum((one - still) ** 2, axis=-1)))) for one in moved)
    assert own < 1e-9
    assert apart(0.2, robot_file(**changes), **sections) < max(1e-10, 1.1 * own)


@pytest.mark.slow
@pytest.mark.parametrize("name", SMOOTH)
def test_an_imperfection_without_friction_moves_the_same_for_seconds(name):
    sizes = SMOOTH[name]
    assert apart(4.0, imperfections={name: sizes} if sizes else {}) < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize("name", ROUGH)
def test_an_imperfection_that_sticks_or_lags_moves_the_same_for_seconds(name):
    assert apart(4.0, imperfections={name: ROUGH[name]}) < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_everything_on_moves_the_same_for_seconds(seed):
    assert apart(4.0, seed=seed, imperfections=EVERYTHING, **DEVICES) < 1e-8


@pytest.mark.slow
def test_the_virtual_prototype_moves_the_same_for_seconds():
    file = load_rig_file()
    both = [seen(driven(SimulatedRig(file.with_engine(each)), 4.0), 4.0) for each in ("compiled", "mujoco")]
    assert np.sqrt(np.mean(np.sum((both[0] - both[1]) ** 2, axis=-1))) < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("changes", OTHERS.values(), ids=list(OTHERS))
def test_another_robot_moves_the_same_for_seconds(changes):
    assert apart(3.0, robot_file(**changes)) < 1e-10


@pytest.mark.slow
def test_samples_are_the_same_on_both_engines():
    """Times, noise, lost points, monitors."""
    robot = robot_file(**SHORT)
    rigs = [driven(SimulatedRig(rig_file(each, robot, EVERYTHING, **DEVICES)), 0.5) for each in ("compiled", "mujoco")]
    for _ in range(50):
        ours, others = (rig.read() for rig in rigs)
        assert (ours.time, ours.status) == (others.time, others.status)
        for name in ("points", "pressures", "tensions"):
            assert getattr(ours, name) == pytest.approx(getattr(others, name), rel=1e-9, abs=1e-9, nan_ok=True)


@pytest.mark.parametrize("name", ["compiled", "mujoco"])
def test_many_frames_at_once_are_those_one_by_one(name):
    """To the byte; commands between them count from where they were given."""
    one, many = (driven(SimulatedRig(rig_file(name, robot_file(**SHORT), EVERYTHING, **DEVICES)), 0.5) for _ in range(2))
    for count in (1, 7, 20):
        for rig in (one, many):
            rig.push(np.array([0.0, 0.01 * count, 0.0]))
            rig.apply(Command.from_inputs(inputs(rig, 1e4 * count, 0.5)))
        for ours, other in zip(many.read_many(count), [one.read() for _ in range(count)], strict=True):
            assert (ours.time, ours.status) == (other.time, other.status)
            for part in ("points", "pressures", "tensions"):
                assert getattr(ours, part).tobytes() == getattr(other, part).tobytes()
        assert (one.true_nodes == many.true_nodes).all()
        assert one.time == many.time


def test_an_interrupted_rig_goes_on_where_it_was(monkeypatch):
    """Ctrl-C between two pieces of many samples: the next sample is the one after those that passed."""
    rig, whole = (driven(SimulatedRig(rig_file("compiled", robot_file(**SHORT), **DEVICES)), 2.0) for _ in range(2))
    expected, record, calls = whole.read_many(101)[-1], rig.machine.record, []

    def interrupted(*arguments: Any) -> machine.Frames:
        calls.append(arguments)
        if len(calls) == 3:  # after the one at the start
            raise KeyboardInterrupt
        return record(*arguments)

    monkeypatch.setattr(rig.machine, "record", interrupted)
    with pytest.raises(KeyboardInterrupt):
        rig.read_many(250)
    found = rig.read()
    assert (found.time, found.points.tobytes()) == (expected.time, expected.points.tobytes())


def test_a_mass_on_a_spring_swings_as_it_should():
    """The bar's three muscles in one: a step of force makes x = F / k (1 − exp(−δ t) (cos ω t + δ / ω sin ω t)) in both of its modes."""
    rig = bar()
    rig.read()
    rig.push(np.array([0.0, 0.0, 0.01]))
    samples = read_until(rig, 0.4)
    body = rig.machine.body
    upright = (body.layout.levels * body.rest[0] / rig.robot.parameters.L_0) ** -2.0 * body.upright  # how far an edge pulls along z
    stiffness, damping, mass = upright @ body.stiffness[0], upright @ body.damping[0], body.mass[0].sum()
    time = np.array([sample.time for sample in samples])
    heights = np.array([sample.points[-1, 2] for sample in samples]) - 0.2
    expected = np.zeros_like(time)
    for eigenvalue, share in zip(*modes_of_two(), strict=True):
        omega_2, delta = eigenvalue * stiffness / mass, eigenvalue * damping / mass / 2
        root = np.emath.sqrt(delta**2 - omega_2)
        swing = np.cosh(root * time) + delta / root * np.sinh(root * time)
        expected += share * 0.01 / (mass * omega_2) * np.real(1 - np.exp(-delta * time) * swing)
    assert heights == pytest.approx(expected, rel=1e-5, abs=1e-12)


def modes_of_two() -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues of two masses in a row on springs, all 1, and the squares of the last mass' parts in their shapes."""
    values, shapes = np.linalg.eigh(np.array([[2.0, -1.0], [-1.0, 1.0]]))
    return values, shapes[1] ** 2


def test_energy_stays_where_nothing_damps():
    """Springs, weights and motion together, in a swing of some centimetres."""
    rig = rig_of(robot_file(c_a=1e-6), simulation={"engine": "compiled"})
    rig.push(np.array([0.3, 0.0, 0.0]))
    rig.read()
    rig.push(np.zeros(3))
    rig.read_many(2)
    found = []
    for _ in range(60):
        rig.read()
        found.append(energy(rig))
    assert np.ptp(rig.true_points[-1]) > 0.01
    assert np.ptp([kinetic for kinetic, _ in found]) > 1e-3
    total = np.array(found).sum(axis=1)
    assert np.ptp(total) < 1e-5 * np.ptp([kinetic for kinetic, _ in found])


def energy(rig: SimulatedRig) -> tuple[float, float]:
    """Kinetic and potential energy in J."""
    body, network = rig.machine.body, rig.machine.network
    nodes, kinetic = network.nodes, (body.mass[..., None] * network.velocities[1:] ** 2).sum() / 2
    potential = -(body.mass[..., None] * nodes[1:] * body.gravity).sum()
    for k, edge in enumerate(body.layout.edges):
        (a, i), (b, j) = edge.a, edge.b
        n = body.layout.levels
        stretch = np.linalg.norm(nodes[b : b + n, j] - nodes[a : a + n, i], axis=1) - body.rest[:, k]
        potential += (body.stiffness[:, k] * stretch**2).sum() / 2
    return float(kinetic), float(potential)


def test_forces_at_rest_are_mujocos():
    """At places far from any equilibrium, under motors and loads."""
    random, file = np.random.default_rng(2), rig_file("compiled")
    ours, other = CompiledMachine(file, library()), MujocoMachine(file)
    shape = ours.network.rest[1:].shape
    places, push = random.normal(size=(4, np.prod(shape))) * 5e-3, random.normal(size=(4, *shape[:2]))
    load = random.normal(size=(4, 3))
    for each in (ours, other):
        each.network.load(load)
    forces = ours.network.forces_at_rest(places, push)
    assert forces == pytest.approx(other.network.forces_at_rest(places, push), rel=1e-10, abs=1e-10)
    assert np.abs(forces).max() > 1


def library() -> Any:
    built = engine.library(Layout.from_robot(load_robot("kang2017")))
    assert built is not None
    return built


@pytest.mark.slow
def test_vectors_width_does_not_matter(monkeypatch):
    """The same bytes for one, four or eight levels a vector."""
    found = []
    for lanes in (1, 4, 8):
        monkeypatch.setattr(engine, "LANES", lanes)
        found.append(seen(driven(SimulatedRig(rig_file("compiled", imperfections=EVERYTHING, **DEVICES)), 0.2), 0.2))
    assert all(each.tobytes() == found[0].tobytes() for each in found)


@pytest.mark.parametrize("name", ["compiled", "mujoco"])
def test_divergence_leaves_the_frames_before_it(name, tmp_path, monkeypatch):
    """What came before is handed out, then the error says when: a force of tons pulls the robot out of all bounds."""
    monkeypatch.chdir(tmp_path)
    rig = rig_of(simulation={"engine": name})
    nothing = np.zeros((2, rig.layout.inputs))
    rig.schedule(SetPoints(np.array([0.0, 0.5]), nothing, np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1e6]])))
    samples = rig.read_many(100)
    assert 1 < len(samples) < 50
    assert np.isfinite(samples[-1].points).all()
    for _ in range(2):
        with pytest.raises(machine.Diverged, match=r"diverged before 0\.\d* s in steps of 0.00025 s .*try 0.00013 in a rig file"):
            rig.read_many(10)


def test_stiff_and_light_robots_get_shorter_steps():
    """Whole parts of the tracker's period; five times stiffer muscles and many segments move without blowing up, on both engines."""
    stiff = robot_file(modules=1, segments_per_module=12)
    for name in ("compiled", "mujoco"):
        rig = SimulatedRig(rig_file(name, stiff, parameter_factors={"K_a": 5.0, "c_a": 5.0}))
        step = rig.machine.step
        assert step < 2.5e-5
        assert 0.01 / step == pytest.approx(round(0.01 / step), abs=1e-9)
        rig.read()
        rig.apply(Command.from_inputs(inputs(rig, [1e5, 0, 0])))
        assert np.isfinite(rig.read_many(3)[-1].points).all()


def test_longest_step_is_that_of_all_modes():
    """Not far below RK4's limit for the eigenvalues of the network's linear equations, numerically differentiated, and never above."""
    for changes in ({}, {"c_a": 0.2}, {"m_d": 0.05}, {"beta_2": 30.0}):
        file = rig_file("compiled", robot_file(**changes, gravity_m_per_s2=(0, 0, 0)))
        machine_, body = CompiledMachine(file, library()), Body.from_robot(file.true_robot)
        machine_.network.load(np.zeros((4, 3)))
        size = machine_.network.rest[1:].size
        force = machine_.network.forces_at_rest(1e-7 * np.eye(size), np.zeros((size, *machine_.network.rest[1:].shape[:2])))
        weights = np.repeat(body.mass.ravel(), 3)
        stiffness = -force.T / 1e-7 / weights[:, None]
        body.stiffness[:] = body.damping
        soft = CompiledMachine(file, library())
        soft.network._kept["stiffness"][:] = soft.network._fill_up(body.stiffness)
        soft.network._kept["preload"][:] = soft.network._fill_up(body.stiffness * body.rest)
        soft.network.load(np.zeros((4, 3)))
        damping = -soft.network.forces_at_rest(1e-7 * np.eye(size), np.zeros((size, *soft.network.rest[1:].shape[:2]))).T
        system = np.block([[np.zeros((size, size)), np.eye(size)], [-stiffness, -damping / 1e-7 / weights[:, None]]])
        rates = np.linalg.eigvals(system)
        limit = max(h for h in np.geomspace(1e-5, 1e-2, 400) if (np.abs(amplified(h * rates)) <= 1 + 1e-6).all())
        assert 0.75 * limit < longest_step(Body.from_robot(file.true_robot)) < limit


def amplified(z: np.ndarray) -> np.ndarray:
    """RK4's factor of a step."""
    return 1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24


def test_long_steps_are_kept_where_the_robot_bears_them():
    assert rig_of().machine.step == SimulatedRig().machine.step == 2.5e-4
    assert rig_of(simulation={"step_s": 1e-3}, tracker={"rate_hz": 50}).machine.step == pytest.approx(0.02 / 54)


def without_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    store.warn_once.cache_clear()
    monkeypatch.setattr(c_compiler, "find_compiler", lambda: None)
    monkeypatch.setattr(engine, "_library", engine._library.__wrapped__)


def test_without_a_compiler_mujoco_runs(monkeypatch):
    without_compiler(monkeypatch)
    with pytest.warns(RuntimeWarning, match="no C compiler found: everything works"):
        rig = rig_of()
    assert isinstance(rig.machine, MujocoMachine)
    with pytest.raises(InputError, match=r"simulation\.engine = 'compiled': there is no working C compiler; valid: auto, mujoco"):
        rig_of(simulation={"engine": "compiled"})


class Halved(StaticMap):
    """A stage that inherits the numbers of another, but does something else."""

    def step(self, pressure: np.ndarray, duration: float) -> np.ndarray:
        return 0.5 * pressure

    settle = partialmethod(step, duration=0.0)


class Unheard(StaticMap):
    """A stage with numbers for a function that is not there."""

    def __init__(self) -> None:
        super().__init__(lambda pressure: 0.5 * pressure, Numbers("unheard"))


class Misplaced(StaticMap):
    """A stage with numbers for a function that acts on something else."""

    def __init__(self) -> None:
        super().__init__(lambda pressure: 0.5 * pressure, Numbers("take_up", (0.0, 1.0, 0.2)))


class Silent:
    """A stage without numbers."""

    settle, step = Halved.settle, Halved.step


class Odd(PressureDeadZone):
    """An imperfection of a package of one's own."""

    kind: str = ""

    def pressure_stage(self, robot):
        stages = {"Halved": Halved(lambda pressure: pressure, Numbers("gain", channels=(np.ones(3),)))}
        return stages.get(self.kind) or {"Unheard": Unheard, "Misplaced": Misplaced, "Silent": Silent}[self.kind]()


@pytest.mark.parametrize("kind", ["Halved", "Unheard", "Misplaced", "Silent"])
def test_an_imperfection_that_c_does_not_have_runs_on_mujoco(kind):
    """It is said, and it acts."""
    store.warn_once.cache_clear()
    odd = Imperfections().model_copy(update={"pressure_dead_zone": Odd(kind=kind)})
    file = rig_file("auto", robot_file(**BAR, gravity_m_per_s2=(0, 0, 0))).model_copy(update={"imperfections": odd})
    with pytest.warns(RuntimeWarning, match=f"the rig runs on MuJoCo, some 70 times slower: {kind} has no counterpart in C"):
        rig = SimulatedRig(file)
    assert isinstance(rig.machine, MujocoMachine)
    plain = bar()
    for each, pressure in ((rig, 1e5), (plain, 0.5e5)):
        ramps(each, [0.0, 0.1], [0.0, pressure])
        read_until(each, 0.3)
    assert rig.true_lengths == pytest.approx(plain.true_lengths, abs=1e-12)
    with pytest.raises(InputError, match=f"{kind} has no counterpart in C; valid: auto, mujoco"):
        SimulatedRig(file.with_engine("compiled"))


def test_engines_by_name():
    for text, kind in {"sim": CompiledMachine, "sim@mujoco": MujocoMachine, "sim:perfect@compiled": CompiledMachine}.items():
        rig = open_rig(text)
        assert isinstance(rig, SimulatedRig)
        assert isinstance(rig.machine, kind)
    with pytest.raises(InputError, match=r"unknown engine 'fast'.*valid: auto, compiled, mujoco"):
        open_rig("sim:perfect@fast")
    with pytest.raises(InputError, match="neither a file nor built in"):
        open_rig("sim:rig@home/rig.toml")
    with pytest.raises(InputError, match="unknown rig 'sim@mujoco:perfect'"):
        open_rig("sim@mujoco:perfect")


@pytest.mark.slow
def test_mujoco_is_not_needed():
    """Nor CasADi, where nothing is to be drawn or solved."""
    rig = "from tepm_opt.hw.simulation.rig import SimulatedRig; SimulatedRig().read()"
    code = f"import sys; {rig}; print({{'mujoco', 'casadi'}} & {{*sys.modules}})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr) == ("set()", "")


def test_timelines_grow_and_forget():
    """Knots as a list would keep them, whatever room they have."""
    random, line, known = np.random.default_rng(4), Timeline(np.zeros(2), 0.1), {0: np.zeros(2)}
    now = 0
    for _ in range(300):
        at, value = now + int(random.integers(0, 6)), random.normal(size=2)
        line.set(at, value)
        known = {knot: kept for knot, kept in known.items() if knot < at} | {at: value}
        for step in range(now, now + 10):
            last = max(knot for knot in known if knot <= step)
            assert (line.evaluate_between(step, step) == known[last]).all()
            assert line.next_knot(step, -1) == min((knot for knot in known if knot > step), default=-1)
        now += int(random.integers(0, 4))
        line.forget(now)
    assert len(line.at) < 100

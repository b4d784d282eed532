"""The base pose and the holders from a calibration recording."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tepm_opt.errors import InputError
from tepm_opt.hw.service.registration import _RegistrationProblem, register_base
from tepm_opt.models.robot import Mount

LENGTH = 0.4
TURN, PLACE = np.array([20.0, -150.0, 35.0]), np.array([0.31, -0.12, 0.25])
HOLDERS = np.array([[0.04, 0, 0], [0.0, 0.04, 0.005], [0.02, -0.03, 0], [0.04, 0.001, -0.01]])
NOISE = 0.6e-3


def arms(samples: int, side: float = np.pi, bend: float = 1.5, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Arms of constant curvature in the base frame: points (samples, 4, 3) in m and rotations (samples, 4, 3, 3)."""
    random = np.random.default_rng(seed)
    total, azimuth = random.uniform(0, bend, samples), random.uniform(-side, side, samples)
    along = np.linspace(0.25, 1, 4)
    angle = np.maximum(total[:, None] * along, 1e-9)
    radius = LENGTH * along / angle
    flat = np.stack([radius * (1 - np.cos(angle)), 0 * angle, radius * np.sin(angle)], axis=-1)
    swing = Rotation.from_euler("z", azimuth[:, None]).as_matrix()
    axes = np.stack([-np.sin(azimuth), np.cos(azimuth), 0 * azimuth], axis=-1)
    turns = Rotation.from_rotvec((angle[:, :, None] * axes[:, None]).reshape(-1, 3)).as_matrix()
    return np.einsum("nij,npj->npi", swing, flat), turns.reshape(samples, 4, 3, 3)


def recorded(points: np.ndarray, turns: np.ndarray, noise: float = 0.0, seed: int = 2, angles: float = 0.0) -> np.ndarray:
    """Sensor poses (samples, 4, 4, 4) of such arms, with noise in m and rad an axis; the sensors sit crooked on their holders."""
    random = np.random.default_rng(seed)
    base = Rotation.from_rotvec(np.deg2rad(TURN)).as_matrix()
    crooked = Rotation.from_rotvec([[0.3 * i, -0.5, 1.0 - 0.4 * i] for i in range(4)]).as_matrix()
    poses = np.tile(np.eye(4), (*points.shape[:2], 1, 1))
    poses[..., :3, :3] = base @ turns @ crooked
    poses[..., :3, 3] = points @ base.T + PLACE - np.einsum("npij,pj->npi", poses[..., :3, :3], HOLDERS)
    poses[..., :3, 3] += noise * random.normal(size=points.shape)
    shaken = Rotation.from_rotvec(angles * random.normal(size=(points.size // 3, 3))).as_matrix()
    poses[..., :3, :3] = shaken.reshape(turns.shape) @ poses[..., :3, :3]
    return poses


def test_without_noise_all_is_found():
    """Base pose and holders come back, from a start 40 mm off, and the mount they make has the same rotation."""
    points, turns = arms(60)
    found = register_base(recorded(points, turns), points)
    assert found.rotation_deg == pytest.approx(TURN, abs=1e-5)
    assert found.position_m == pytest.approx(PLACE, abs=1e-8)
    assert found.holders_m == pytest.approx(HOLDERS, abs=1e-8)
    assert (found.notes, found.outliers, found.samples) == ((), 0, 60)
    mount = Mount(gravity_m_per_s2=(0, 0, -9.81), base_position_m=tuple(found.position_m), base_rotation_deg=tuple(found.rotation_deg))
    poses = recorded(points, turns)
    seen = np.einsum("npij,pj->npi", poses[..., :3, :3], found.holders_m) + poses[..., :3, 3]
    assert points @ mount.rotation.T + mount.base_position_m == pytest.approx(seen, abs=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("recordings", [15, pytest.param(30, marks=pytest.mark.slow)])
def test_noise_and_what_is_said_about_it(recordings):
    """0.6 mm an axis: the errors over many recordings are as large as the standard deviations say, and the residual is the noise."""
    points, turns = arms(150)
    errors, deviations, residuals = [], [], []
    for seed in range(recordings):
        found = register_base(recorded(points, turns, NOISE, seed), points)
        turn = Rotation.from_rotvec(np.deg2rad(found.rotation_deg)) * Rotation.from_rotvec(np.deg2rad(TURN)).inv()
        errors.append([*np.rad2deg(turn.as_rotvec()), *(found.position_m - PLACE), *(found.holders_m - HOLDERS).ravel()])
        deviations.append([*found.rotation_std_deg, *found.position_std_m, *found.holders_std_m.ravel()])
        residuals.append(found.rms_m)
    ratio = np.sqrt((np.array(errors) ** 2).mean(axis=0)) / np.array(deviations).mean(axis=0)
    assert ((ratio > 0.6) & (ratio < 1.5)).all()
    assert np.sqrt((ratio**2).mean()) == pytest.approx(1, abs=0.2)
    assert np.mean(residuals) == pytest.approx(np.sqrt(3) * NOISE, rel=0.03)
    assert np.abs(errors).max(axis=0)[:6] == pytest.approx(np.zeros(6), abs=0.5)
    assert np.abs(np.array(errors)[:, 3:6]).max() < 1e-3


def test_known_holders():
    """Holders that are given stay; the pose is told better then."""
    points, turns = arms(100)
    poses = recorded(points, turns, NOISE)
    given, free = register_base(poses, points, HOLDERS), register_base(poses, points)
    assert (given.holders_m == HOLDERS).all()
    assert (given.holders_std_m == 0).all()
    assert (given.position_std_m < free.position_std_m).all()
    assert given.position_m == pytest.approx(PLACE, abs=5 * given.position_std_m.max())
    wrong = register_base(poses, points, np.zeros((4, 3)))
    assert wrong.rms_m > 5 * given.rms_m


@pytest.mark.slow
def test_outliers_hardly_count():
    """One pose in twenty off by decimetres: the base stays where it is to a millimetre, and they are counted."""
    points, turns = arms(200)
    poses = recorded(points, turns, NOISE)
    clean = register_base(poses, points)
    random = np.random.default_rng(5)
    wild = random.random((200, 4)) < 0.05
    poses[wild, :3, 3] += random.uniform(0.1, 0.4, (wild.sum(), 1)) * np.array([1.0, 0.5, -0.3])
    found = register_base(poses, points)
    assert found.outliers == wild.sum()
    assert found.position_m == pytest.approx(clean.position_m, abs=1e-3)
    assert found.rotation_deg == pytest.approx(clean.rotation_deg, abs=0.3)
    assert found.rms_m == pytest.approx(np.sqrt(3) * NOISE, rel=0.05)


def test_lost_poses_are_left_out():
    """NaN costs data, nothing else; a sample without any sensor is not counted as used."""
    points, turns = arms(80)
    poses = recorded(points, turns)
    poses[np.random.default_rng(3).random((80, 4)) < 0.3] = np.nan
    poses[7] = np.nan
    found = register_base(poses, points)
    assert found.position_m == pytest.approx(PLACE, abs=1e-8)
    assert found.samples == np.isfinite(poses).all(axis=(2, 3)).any(axis=1).sum() < 80


def test_a_sensor_never_seen_is_a_note():
    """Its holder cannot be told; all else is."""
    points, turns = arms(60)
    poses = recorded(points, turns)
    poses[:, 1] = np.nan
    found = register_base(poses, points)
    assert found.notes == ("holder of s2: cannot be told along x, y, z of its sensor; taken as 0 there",)
    assert np.isnan(found.holders_std_m[1]).all()
    assert np.isfinite(np.delete(found.holders_std_m, 1, axis=0)).all()
    assert found.holders_m[1] == pytest.approx(0, abs=1e-12)
    assert found.holders_m[[0, 2, 3]] == pytest.approx(HOLDERS[[0, 2, 3]], abs=1e-8)


@pytest.mark.parametrize("noise", [0.0, NOISE])
def test_bends_to_one_side_leave_a_direction_open(noise):
    """All rotations about one axis: the base may stand anywhere along it, if all holders go with it; with known holders it is told."""
    points, turns = arms(80, side=0.0)
    poses = recorded(points, turns, noise, angles=3 * noise)
    with pytest.raises(InputError, match=r"position along \(0, 1, 0\) of the base is open; valid: .*more than one side"):
        register_base(poses, points)
    assert register_base(poses, points, HOLDERS).position_m == pytest.approx(PLACE, abs=1e-8 + noise)


@pytest.mark.parametrize("noise", [0.0, NOISE])
def test_a_straight_arm_does_not_tell_its_turn(noise):
    """Points on a line: rotation about it is open, holders given or not."""
    points, turns = arms(50, bend=1e-6)
    poses = recorded(points, turns, noise, angles=3 * noise)
    with pytest.raises(InputError, match=r"rotation about \(0, 0, 1\) of the base is open; valid: a recording with bent arms$"):
        register_base(poses, points, HOLDERS)
    with pytest.raises(InputError, match="the base pose cannot be found"):
        register_base(poses, points)


def test_input_is_checked():
    """Shapes, units, and enough of it, named."""
    points, turns = arms(10)
    poses = recorded(points, turns)
    with pytest.raises(InputError, match=r"poses: of the shape \(40, 4, 4\); valid: \(samples, points, 4, 4\)"):
        register_base(poses.reshape(-1, 4, 4), points)
    with pytest.raises(InputError, match=r"base_points: of the shape \(10, 3, 3\); valid: \(10, 4, 3\)"):
        register_base(poses, points[:, :3])
    with pytest.raises(InputError, match=r"holders: .*valid: finite numbers of the shape \(4, 3\)"):
        register_base(poses, points, HOLDERS[:3])
    with pytest.raises(InputError, match="poses: 0 that are not lost; valid: at least 3"):
        register_base(np.full_like(poses, np.nan), points)
    poses[..., :3, 3] *= 1000
    with pytest.raises(InputError, match="valid: metres"):
        register_base(poses, points)


def test_derivatives():
    """Against central differences, also where the turn is large."""
    points, turns = arms(5)
    poses = recorded(points, turns)
    problem = _RegistrationProblem(poses.reshape(-1, 4, 4), points.reshape(-1, 3), np.tile(np.arange(4), 5), None, 4)
    at = np.random.default_rng(0).normal(size=18) * 0.1 + [0.3, -0.2, 0.1, *np.zeros(15)]
    steps = 1e-6 * np.eye(18)
    differences = np.array([problem.residuals(at + step) - problem.residuals(at - step) for step in steps]).T / 2e-6
    assert problem.jacobian(at) == pytest.approx(differences, abs=1e-8)

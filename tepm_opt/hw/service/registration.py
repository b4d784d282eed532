"""Pose of the base in the tracker's frame and places of the sensors on the arm, from a calibration recording.

A sensor's pose (R, t) puts its reference point at R h + t; the model puts it at R_z b + t_z, with the base pose (R_z, t_z) sought. This is
hand–eye calibration (robot–world form) in positions. The start is Umeyama's rigid fit (IEEE TPAMI 13(4), 1991) of b to t with the holders
h left out; from there on it is nonlinear least squares, with a loss that bounds what outliers can do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from tepm_opt.errors import InputError

WEAK = 0.01
"""A direction in which a metre of a parameter moves the points by less than this in m (RMS) is not told: sensors' angles err by as much."""
OUTLIER = 5.0
"""Robust standard deviations from which on a residual is an outlier."""


@dataclass(frozen=True, eq=False)
class Registration:
    """Base pose and holders that were found from a calibration recording.

    Attributes:
        rotation_deg: rotation vector from the base frame to the tracker frame G, (3,) in degrees: `mount.base_rotation_deg`.
        position_m: of the base in G, (3,) in m: `mount.base_position_m`.
        holders_m: from each sensor to its reference point in the sensor's frame, (points, 3) in m: `hardware.tracker.holders_m`.
        rotation_std_deg, position_std_m, holders_std_m: standard deviations (rotation: about the axes of G), from residuals taken to be
            independent; model errors are not, so these are the least. 0 for holders that were given, NaN for what cannot be told.
        rms_m: of the distances that remain between both places of a point, outliers left out, in m.
        samples: used: those with a sensor that was not lost.
        outliers: sensor poses that do not fit and hardly counted.
        notes: what cannot be told from this recording, in words.
    """

    rotation_deg: np.ndarray
    position_m: np.ndarray
    holders_m: np.ndarray
    rotation_std_deg: np.ndarray
    position_std_m: np.ndarray
    holders_std_m: np.ndarray
    rms_m: float
    samples: int
    outliers: int
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        place, turn = (np.array2string(values, precision=4, suppress_small=True) for values in (self.position_m, self.rotation_deg))
        return f"Registration({place} m, {turn} deg, rms {1e3 * self.rms_m:.3g} mm, {self.samples} samples, {self.outliers} outliers)"


def register_base(poses: np.ndarray, base_points: np.ndarray, holders: np.ndarray | None = None) -> Registration:
    """Find the base pose, and the holders where they are not given.

    Args:
        poses: of the sensors in the tracker's frame, (samples, points, 4, 4) in m; NaN where one is lost.
        base_points: where the model has the reference points in the base frame, (samples, points, 3) in m.
        holders: from the sensors to the reference points in the sensors' frames, (points, 3) in m, if they are known.

    Raises:
        InputError: wrong shapes or units, or a recording from which the base pose cannot be found; the message says what has to vary.
    """
    poses, base_points = np.asarray(poses, dtype=float), np.asarray(base_points, dtype=float)
    count = _check(poses, base_points, holders)
    sample, point = np.nonzero(np.isfinite(poses).all(axis=(2, 3)) & np.isfinite(base_points).all(axis=2))
    if len(sample) < 3:
        raise InputError(f"poses: {len(sample)} that are not lost; valid: at least 3, of an arm that moves")
    problem = _RegistrationProblem(
        poses[sample, point], base_points[sample, point], point, None if holders is None else np.asarray(holders, float), count
    )
    if np.linalg.norm(problem.shifts, axis=1).max() > 20:
        raise InputError("poses: a sensor more than 20 m from the tracker; valid: metres")
    parameters = problem.solve(problem.start(), np.eye(problem.size), "linear", 1.0)
    basis, notes = problem.find_identifiable_directions(parameters)
    parameters = problem.solve(basis @ (basis.T @ parameters), basis, "linear", 1.0)
    scale = 0.0
    for _ in range(2):  # the second time with the noise of what the first one recognised as good
        scale = max(1.4826 * float(np.median(np.abs(problem.residuals(parameters)))), 1e-9)
        parameters = problem.solve(parameters, basis, "soft_l1", scale)
    return problem.result(parameters, basis, scale, len(set(sample.tolist())), tuple(notes))


def _check(poses: np.ndarray, base_points: np.ndarray, holders: np.ndarray | None) -> int:
    """Shapes; the number of points."""
    if poses.ndim != 4 or poses.shape[2:] != (4, 4):
        raise InputError(f"poses: of the shape {poses.shape}; valid: (samples, points, 4, 4)")
    if base_points.shape != (*poses.shape[:2], 3):
        raise InputError(f"base_points: of the shape {base_points.shape}; valid: {(*poses.shape[:2], 3)}, as the poses have it")
    if holders is not None and (np.shape(holders) != (poses.shape[1], 3) or not np.isfinite(holders).all()):
        raise InputError(f"holders: {np.asarray(holders).tolist()}; valid: finite numbers of the shape {(poses.shape[1], 3)}")
    return poses.shape[1]


class _RegistrationProblem:
    """Residuals R h + t − R_z b − t_z of all poses that are not lost, and their derivatives.

    Parameters are metres throughout: turn · reach about the axes of G (from `turned`), t_z at the arm's middle, and h of each sensor.
    """

    def __init__(self, poses: np.ndarray, base_points: np.ndarray, point: np.ndarray, holders: np.ndarray | None, count: int) -> None:
        self.rotations, self.shifts, self.point, self.known, self.count = poses[:, :3, :3], poses[:, :3, 3], point, holders, count
        self.middle = base_points.mean(axis=0)
        self.arms = base_points - self.middle
        self.reach = max(float(np.sqrt((self.arms**2).sum(axis=1).mean())), 1e-6)
        self.size = 6 if holders is not None else 6 + 3 * count
        self.turned = Rotation.identity()

    def start(self) -> np.ndarray:
        """Parameters of the rigid fit of the points (Umeyama), with the holders given or none."""
        seen = self.shifts + self._rotate_holders(np.zeros(self.size))
        left, _, right = np.linalg.svd((seen - seen.mean(axis=0)).T @ self.arms)
        proper = np.diag([1.0, 1.0, np.linalg.det(left) * np.linalg.det(right)])
        self.turned = Rotation.from_matrix(left @ proper @ right)
        return np.concatenate([np.zeros(3), seen.mean(axis=0), np.zeros(self.size - 6)])

    def residuals(self, parameters: np.ndarray) -> np.ndarray:
        """Residuals of all poses, (3 · poses,) in m."""
        placed = self._rotation(parameters).apply(self.arms) + parameters[3:6]
        return (self.shifts + self._rotate_holders(parameters) - placed).ravel()

    def jacobian(self, parameters: np.ndarray) -> np.ndarray:
        """Derivatives of the residuals, (3 · poses, parameters)."""
        x, y, z = self._rotation(parameters).apply(self.arms).T / self.reach
        rows = np.zeros((len(self.arms), 3, self.size))
        rows[:, 0, 1], rows[:, 0, 2] = -z, y
        rows[:, 1, 0], rows[:, 1, 2] = z, -x
        rows[:, 2, 0], rows[:, 2, 1] = -y, x
        rows[:, :, :3] = rows[:, :, :3] @ _compute_left_jacobian(parameters[:3] / self.reach)
        rows[:, :, 3:6] = -np.eye(3)
        if self.known is None:
            each = rows[:, :, 6:].reshape(len(rows), 3, self.count, 3)
            each[np.arange(len(rows)), :, self.point] = self.rotations
        return rows.reshape(-1, self.size)

    def solve(self, parameters: np.ndarray, basis: np.ndarray, loss: str, scale: float) -> np.ndarray:
        """Least squares along the columns of `basis`; the turn found goes into `turned`, so that the parameters' own is 0 again."""
        found = least_squares(
            lambda step: self.residuals(parameters + basis @ step),
            np.zeros(basis.shape[1]),
            jac=lambda step: self.jacobian(parameters + basis @ step) @ basis,  # pyright: ignore[reportArgumentType]  SciPy's own hint is wrong
            loss=loss,
            f_scale=scale,
            xtol=1e-12,
        )
        parameters = parameters + basis @ found.x
        self.turned = self._rotation(parameters)
        return np.concatenate([np.zeros(3), parameters[3:]])

    def find_identifiable_directions(self, parameters: np.ndarray) -> tuple[np.ndarray, list[str]]:
        """Find the directions of the parameters that the recording determines, (parameters, directions), and words about the others.

        Raises:
            InputError: one of the others has to do with the base pose.
        """
        rows = self.jacobian(parameters)
        _, strength, directions = np.linalg.svd(rows / np.sqrt(len(self.arms)), full_matrices=True)
        strength = np.pad(strength, (0, self.size - len(strength)))
        weak = directions[strength < WEAK]
        _, shares, of_pose = np.linalg.svd(weak[:, :6])
        if len(weak) and shares[0] > 0.1:
            raise InputError(f"poses: the base pose cannot be found: {self._explain_open_pose(of_pose[0])}")
        words = []
        for sensor in range(self.count if self.known is None else 0):
            free = weak[:, 6 + 3 * sensor : 9 + 3 * sensor]
            if len(free) and (amount := np.linalg.norm(free, axis=0)).max() > 0.1:
                axes = ", ".join(axis for axis, part in zip("xyz", amount, strict=True) if part > 0.1)
                words.append(f"holder of s{sensor + 1}: cannot be told along {axes} of its sensor; taken as 0 there")
        return directions[strength >= WEAK].T, words

    def result(self, parameters: np.ndarray, basis: np.ndarray, scale: float, samples: int, notes: tuple[str, ...]) -> Registration:
        """All that is said about a solution."""
        residuals, rows = self.residuals(parameters).reshape(-1, 3), self.jacobian(parameters).reshape(-1, 3, self.size)
        good = np.linalg.norm(residuals, axis=1) <= OUTLIER * np.sqrt(3) * scale
        square = float((residuals[good] ** 2).sum())
        along = rows[good].reshape(-1, self.size) @ basis
        covariance = basis @ np.linalg.inv(along.T @ along) @ basis.T * square / max(3 * good.sum() - basis.shape[1], 1)
        back = np.eye(self.size)[:6]  # the base's position is t_z − R_z middle
        moment = self.turned.apply(self.middle) / self.reach
        back[3:, :3] = [[0, -moment[2], moment[1]], [moment[2], 0, -moment[0]], [-moment[1], moment[0], 0]]
        pose_std = np.sqrt(np.diag(back @ covariance @ back.T))
        holders_std = np.sqrt(np.maximum(np.diag(covariance)[6:], 0)).reshape(-1, 3)
        untold = 1 - (basis[6:] ** 2).sum(axis=1).reshape(-1, 3) > 0.01
        return Registration(
            rotation_deg=np.rad2deg(self.turned.as_rotvec()),
            position_m=parameters[3:6] - self.turned.apply(self.middle),
            holders_m=parameters[6:].reshape(-1, 3) if self.known is None else self.known.copy(),
            rotation_std_deg=np.rad2deg(pose_std[:3] / self.reach),
            position_std_m=pose_std[3:],
            holders_std_m=np.where(untold, np.nan, holders_std) if self.known is None else np.zeros((self.count, 3)),
            rms_m=float(np.sqrt(square / max(good.sum(), 1))),
            samples=samples,
            outliers=int((~good).sum()),
            notes=notes,
        )

    def _explain_open_pose(self, direction: np.ndarray) -> str:
        turn, shift = self.turned.inv().apply(direction[:3]), self.turned.inv().apply(direction[3:6])
        kind, axis = ("rotation about", turn) if np.linalg.norm(turn) > np.linalg.norm(shift) else ("position along", shift)
        named = np.round(axis / np.linalg.norm(axis), 2) + 0.0
        named = named * (np.sign(named[np.argmax(np.abs(named))]) or 1.0) + 0.0
        needs = "bent arms, to more than one side" if self.known is None else "bent arms"
        return f"its {kind} ({named[0]:g}, {named[1]:g}, {named[2]:g}) of the base is open; valid: a recording with {needs}"

    def _rotation(self, parameters: np.ndarray) -> Rotation:
        return Rotation.from_rotvec(parameters[:3] / self.reach) * self.turned

    def _rotate_holders(self, parameters: np.ndarray) -> np.ndarray:
        holders = self.known if self.known is not None else parameters[6:].reshape(-1, 3)
        return np.einsum("nij,nj->ni", self.rotations, holders[self.point])


def _compute_left_jacobian(turn: np.ndarray) -> np.ndarray:
    """Derivative of a turn, as a rotation vector about fixed axes, by its rotation vector (3,) in rad: (3, 3)."""
    angle, cross = float(np.linalg.norm(turn)), np.cross(np.eye(3), turn)
    if angle < 1e-4:
        return np.eye(3) + cross / 2
    return np.eye(3) + (1 - np.cos(angle)) / angle**2 * cross + (angle - np.sin(angle)) / angle**3 * cross @ cross

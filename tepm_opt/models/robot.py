"""The robot file: what a lab writes down about its machine (TOML), checked before anything is computed from it."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from tepm_opt.data.documents import Section, Vector, parse_toml, read_text, require_range, validate
from tepm_opt.errors import InputError, unknown_name
from tepm_opt.models.hardware import Hardware

SUFFIX = ".toml"
WAY = "tepm reads robot files in TOML: start one with `tepm robot new mine.toml`"
LEAST_STIFFNESS = 5.0  # N/m, K_a of what stands by itself


class Geometry(Section):
    """Layout of the network (SPEC section 2)."""

    modules: Annotated[int, Field(strict=True, ge=1, le=20, description="1 … 20")]
    segments_per_module: Annotated[int, Field(strict=True, ge=1, le=100, description="1 … 100")]
    actuator_angles_deg: Annotated[
        tuple[Annotated[float, require_range(-360, 360, "deg")], ...], Field(min_length=3, max_length=12, description="3 … 12 angles")
    ]
    bracing: Literal["crossed", "single"]
    guide: Annotated[bool, Field(strict=True, description="true where the plates slide on straight rails along the base axis")] = False

    @model_validator(mode="after")
    def _distinct_and_spread(self) -> Geometry:
        angles = np.sort(np.mod(self.actuator_angles_deg, 360.0))
        gaps = np.diff(np.append(angles, angles[0] + 360.0))
        if gaps.min() < 1.0:
            raise ValueError("actuator_angles_deg: two actuators sit at the same angle; give angles at least 1 deg apart")
        if gaps.max() > 180.0 + 1e-9:
            raise ValueError("actuator_angles_deg: all actuators sit on one side; no gap may exceed 180 deg")
        return self


class Parameters(Section):
    """The physical parameters, all symbolic in the network; symbols are the paper's."""

    L_0: Annotated[float, require_range(1e-3, 10, "m")]
    r: Annotated[float, require_range(1e-3, 0.3, "m")]
    A: Annotated[float, require_range(1e-7, 1e-2, "m^2")]
    m_d: Annotated[float, require_range(1e-4, 100, "kg")]
    K_a: Annotated[float, require_range(0, 1e5, "N/m")]
    c_a: Annotated[float, require_range(0, 500, "N s/m")]
    alpha_1: Annotated[float, require_range(1e-6, 1e5, "")]
    alpha_2: Annotated[float, require_range(1e-6, 1e5, "")]
    beta_1: Annotated[float, require_range(0, 1e5, "")]
    beta_2: Annotated[float, require_range(0, 1e5, "")]


UNITS: Mapping[str, str] = {
    "L_0": "m", "r": "m", "A": "m^2", "m_d": "kg", "K_a": "N/m", "c_a": "N s/m",
    "alpha_1": "-", "alpha_2": "-", "beta_1": "-", "beta_2": "-",
}  # fmt: skip


class Actuation(Section):
    """Ranges and resolutions of regulators and tendon motors (SPEC section 1), and how fast they are as far as a controller knows.

    Of a regulator the time constants of filling and exhausting, of a motor how fast its tension changes (0: at once), of all commands how
    late they act.
    """

    pressure_max_Pa: Annotated[float, require_range(1e3, 2e7, "Pa")]
    pressure_full_scale_Pa: Annotated[float, require_range(1e3, 2e7, "Pa")]
    pressure_resolution: Annotated[float, require_range(0, 0.5, "of full scale")]
    tension_max_N: Annotated[float, require_range(1e-3, 1e4, "N")]
    tension_full_scale_N: Annotated[float, require_range(1e-3, 1e4, "N")]
    tension_resolution: Annotated[float, require_range(0, 0.5, "of full scale")]
    filling_time_s: Annotated[float, require_range(0, 10, "s")] = 0.0
    exhausting_time_s: Annotated[float, require_range(0, 10, "s")] = 0.0
    tension_rate_N_per_s: Annotated[float, require_range(0, 1e5, "N/s")] = 0.0
    command_delay_s: Annotated[float, require_range(0, 1, "s")] = 0.0

    @property
    def pressure_step(self) -> float:
        """One step of the regulator in Pa; 0 where it is continuous."""
        return self.pressure_resolution * self.pressure_full_scale_Pa

    @property
    def tension_step(self) -> float:
        """One step of the tendon motor in N; 0 where it is continuous."""
        return self.tension_resolution * self.tension_full_scale_N

    def on_grid(self, inputs: np.ndarray) -> np.ndarray:
        """Inputs u = [pressures, tensions], (…, 2 · modules · actuators) in Pa and N, as `pressures_on_grid` and `tensions_on_grid`."""
        rounded = np.array(inputs, dtype=float)
        half = rounded.shape[-1] // 2
        rounded[..., :half] = self.pressures_on_grid(rounded[..., :half])
        rounded[..., half:] = self.tensions_on_grid(rounded[..., half:])
        return rounded

    def pressures_on_grid(self, pressures: np.ndarray) -> np.ndarray:
        """Pressures in Pa rounded to the regulators' steps, from 0 to the largest step within their limit; continuous ones stay."""
        return on_grid(pressures, self.pressure_step, self.pressure_max_Pa)

    def tensions_on_grid(self, tensions: np.ndarray) -> np.ndarray:
        """Tensions in N rounded to the motors' steps, from 0 to the largest step within their limit; continuous ones stay."""
        return on_grid(tensions, self.tension_step, self.tension_max_N)

    @model_validator(mode="after")
    def _range_within_full_scale(self) -> Actuation:
        for kind, unit in (("pressure", "Pa"), ("tension", "N")):
            largest, full = getattr(self, f"{kind}_max_{unit}"), getattr(self, f"{kind}_full_scale_{unit}")
            if largest > full * (1 + 1e-9):
                raise ValueError(f"{kind}_max_{unit} = {largest:g} exceeds {kind}_full_scale_{unit} = {full:g}")
        return self


def on_grid(values: np.ndarray, step: float | np.ndarray, limit: float | np.ndarray) -> np.ndarray:
    """Values rounded to whole steps, from 0 to the largest step within `limit`; as they are where the step is 0 (continuous)."""
    whole = np.where(np.equal(step, 0), 1.0, step)
    steps = np.minimum(np.maximum(np.rint(np.divide(values, whole)), 0.0), np.floor(limit / whole * (1 + 1e-12)))
    return np.where(np.equal(step, 0), values, steps * whole)


class Mount(Section):
    """Pose of the base plate in the tracker frame G."""

    gravity_m_per_s2: Vector
    base_position_m: Vector
    base_rotation_deg: Vector

    @property
    def rotation(self) -> np.ndarray:
        """Rotation matrix (3, 3) from the base frame to G."""
        return Rotation.from_rotvec(np.deg2rad(self.base_rotation_deg)).as_matrix()

    @model_validator(mode="after")
    def _magnitudes(self) -> Mount:
        g = float(np.linalg.norm(self.gravity_m_per_s2))
        if g > 30:
            raise ValueError(f"gravity_m_per_s2 has the magnitude {g:g}; valid: 0 … 30 m/s^2")
        if np.linalg.norm(self.base_position_m) > 10:
            raise ValueError("base_position_m is further than 10 m from the tracker; valid: metres")
        return self


class TrackerSpec(Section):
    """The position tracker: noise of a position (3-D), frames a second, age of a frame when it is read."""

    noise_rms_m: Annotated[float, require_range(0, 0.1, "m")]
    rate_Hz: Annotated[float, require_range(1, 4000, "Hz")] = 100.0
    latency_s: Annotated[float, require_range(0, 1, "s")] = 0.0


class Robot(Section):
    """A robot: plain frozen data in SI units, as read from a robot file."""

    name: Annotated[str, Field(min_length=1)]
    geometry: Geometry
    parameters: Parameters
    priors: dict[str, Annotated[float, require_range(0, 10, "relative half-width")]] = Field(default_factory=dict)
    actuation: Actuation
    mount: Mount
    tracker: TrackerSpec
    hardware: Hardware | None = None

    @model_validator(mode="after")
    def _priors_name_parameters(self) -> Robot:
        for name in self.priors:
            if name not in UNITS:
                raise unknown_name("parameter", name, UNITS, "priors")
        return self

    @model_validator(mode="after")
    def _stands(self) -> Robot:
        if self.parameters.K_a < LEAST_STIFFNESS and not self.geometry.guide:
            least = f"{LEAST_STIFFNESS:g} … 100000 N/m, or from 0 with guide = true"
            raise ValueError(f"parameters: K_a = {self.parameters.K_a:g}: valid: {least}")
        return self

    def __repr__(self) -> str:
        return f"Robot({self.name}: {self.modules} x {self.actuators} actuators, {self.geometry.segments_per_module} segments a module)"

    __str__ = __repr__

    @property
    def modules(self) -> int:
        """Number of modules."""
        return self.geometry.modules

    @property
    def actuators(self) -> int:
        """Number of actuators in a module."""
        return len(self.geometry.actuator_angles_deg)

    @property
    def levels(self) -> int:
        """Number of free levels n = modules · n_e."""
        return self.modules * self.geometry.segments_per_module

    @property
    def angles(self) -> np.ndarray:
        """Angles of the actuators about z in rad, shape (actuators,)."""
        return np.deg2rad(self.geometry.actuator_angles_deg)

    @property
    def input_max(self) -> np.ndarray:
        """Upper limits of u = [pressures in Pa, tensions in N], shape (2 · modules · actuators,); the lower limits are 0."""
        ones = np.ones(self.modules * self.actuators)
        return np.concatenate([self.actuation.pressure_max_Pa * ones, self.actuation.tension_max_N * ones])

    @property
    def input_step(self) -> np.ndarray:
        """Resolution of each input in Pa and N, 0 where continuous, shape (2 · modules · actuators,)."""
        ones = np.ones(self.modules * self.actuators)
        return np.concatenate([self.actuation.pressure_step * ones, self.actuation.tension_step * ones])


def builtin_robots() -> list[str]:
    """Names of the robots that come with the package."""
    folder = resources.files("tepm_opt.models") / "robots"
    return sorted(entry.name.removesuffix(SUFFIX) for entry in folder.iterdir() if entry.name.endswith(SUFFIX))


def robot_text(name: str) -> str:
    """The robot file of a built-in robot, with its comments.

    Raises:
        InputError: no built-in robot has this name.
    """
    if name not in builtin_robots():
        raise unknown_name("robot", name, builtin_robots())
    return (resources.files("tepm_opt.models") / "robots" / f"{name}{SUFFIX}").read_text(encoding="utf-8")


def load_robot(robot: str | Path, where: str = "") -> Robot:
    """A robot by built-in name or by the path of a robot file; `where` names the file that refers to it in errors.

    Raises:
        InputError: unknown name, unreadable file, unknown or missing key, value out of its range (wrong unit).
    """
    if str(robot) in builtin_robots():
        return parse_robot(robot_text(str(robot)), str(robot))
    path = Path(robot)
    if not path.is_file():
        prefix = f"{where}: " if where else ""
        raise InputError(f"{prefix}robot {str(robot)!r} is neither a file nor built in; built in: {', '.join(builtin_robots())}")
    return parse_robot(read_text(path, WAY), str(path))


def parse_robot(text: str, where: str) -> Robot:
    """A robot from the text of a robot file; `where` names the file in errors.

    Raises:
        InputError: as for `load_robot`.
    """
    return validate(Robot, parse_toml(text, where, WAY), where)

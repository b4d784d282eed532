"""The robot file: what a lab writes down about its machine (TOML), checked before anything is computed from it."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from scipy.spatial.transform import Rotation

from tepm_opt.errors import InputError, unknown_name
from tepm_opt.models.hardware import Hardware

SUFFIX = ".toml"
Checked = TypeVar("Checked", bound=BaseModel)


def within(low: float, high: float, unit: str) -> Any:
    """Range that a value in this unit can sensibly have, so that a wrong unit is caught."""
    return Field(ge=low, le=high, allow_inf_nan=False, strict=True, description=f"{low:g} … {high:g} {unit}")


Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Vector = Annotated[tuple[Number, Number, Number], Field(description="three numbers")]


class Section(BaseModel):
    """A table of the robot file: frozen, unknown keys refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Geometry(Section):
    """How the network is laid out (SPEC section 2)."""

    modules: Annotated[int, Field(strict=True, ge=1, le=20, description="1 … 20")]
    segments_per_module: Annotated[int, Field(strict=True, ge=1, le=100, description="1 … 100")]
    actuator_angles_deg: Annotated[
        tuple[Annotated[float, within(-360, 360, "deg")], ...], Field(min_length=3, max_length=12, description="3 … 12 angles")
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

    L_0: Annotated[float, within(1e-3, 10, "m")]
    r: Annotated[float, within(1e-3, 0.3, "m")]
    A: Annotated[float, within(1e-7, 1e-2, "m^2")]
    m_d: Annotated[float, within(1e-4, 100, "kg")]
    K_a: Annotated[float, within(5, 1e5, "N/m")]
    c_a: Annotated[float, within(0, 500, "N s/m")]
    alpha_1: Annotated[float, within(1e-6, 1e5, "")]
    alpha_2: Annotated[float, within(1e-6, 1e5, "")]
    beta_1: Annotated[float, within(0, 1e5, "")]
    beta_2: Annotated[float, within(0, 1e5, "")]


UNITS: Mapping[str, str] = {
    "L_0": "m", "r": "m", "A": "m^2", "m_d": "kg", "K_a": "N/m", "c_a": "N s/m",
    "alpha_1": "-", "alpha_2": "-", "beta_1": "-", "beta_2": "-",
}  # fmt: skip


class Actuation(Section):
    """Ranges and resolutions of regulators and tendon motors (SPEC section 1), and how fast they are as far as a controller knows.

    Of a regulator the time constants of filling and exhausting, of a motor how fast its tension changes (0: at once), of all commands how
    late they act.
    """

    pressure_max_Pa: Annotated[float, within(1e3, 2e7, "Pa")]
    pressure_full_scale_Pa: Annotated[float, within(1e3, 2e7, "Pa")]
    pressure_resolution: Annotated[float, within(0, 0.5, "of full scale")]
    tension_max_N: Annotated[float, within(1e-3, 1e4, "N")]
    tension_full_scale_N: Annotated[float, within(1e-3, 1e4, "N")]
    tension_resolution: Annotated[float, within(0, 0.5, "of full scale")]
    filling_time_s: Annotated[float, within(0, 10, "s")] = 0.0
    exhausting_time_s: Annotated[float, within(0, 10, "s")] = 0.0
    tension_rate_N_per_s: Annotated[float, within(0, 1e5, "N/s")] = 0.0
    command_delay_s: Annotated[float, within(0, 1, "s")] = 0.0

    @property
    def pressure_step(self) -> float:
        """One step of the regulator in Pa; 0 where it is continuous."""
        return self.pressure_resolution * self.pressure_full_scale_Pa

    @property
    def tension_step(self) -> float:
        """One step of the tendon motor in N; 0 where it is continuous."""
        return self.tension_resolution * self.tension_full_scale_N

    @model_validator(mode="after")
    def _range_within_full_scale(self) -> Actuation:
        for kind, unit in (("pressure", "Pa"), ("tension", "N")):
            largest, full = getattr(self, f"{kind}_max_{unit}"), getattr(self, f"{kind}_full_scale_{unit}")
            if largest > full * (1 + 1e-9):
                raise ValueError(f"{kind}_max_{unit} = {largest:g} exceeds {kind}_full_scale_{unit} = {full:g}")
        return self


class Mount(Section):
    """How the base plate stands in the tracker frame G."""

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

    noise_rms_m: Annotated[float, within(0, 0.1, "m")]
    rate_Hz: Annotated[float, within(1, 4000, "Hz")] = 100.0
    latency_s: Annotated[float, within(0, 1, "s")] = 0.0


class Robot(Section):
    """A robot: plain frozen data in SI units, as read from a robot file."""

    name: Annotated[str, Field(min_length=1)]
    geometry: Geometry
    parameters: Parameters
    priors: dict[str, Annotated[float, within(0, 10, "relative half-width")]] = Field(default_factory=dict)
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
    return parse_robot(read_text(path), str(path))


def read_text(path: Path) -> str:
    """The text of a file a person names, or an `InputError` that says why it cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not a text file (UTF-8)") from error


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """A TOML document, or an `InputError` with file, line and column."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{where}: not valid TOML: {error}") from error


def parse_robot(text: str, where: str) -> Robot:
    """A robot from the text of a robot file; `where` names the file in errors.

    Raises:
        InputError: as for `load_robot`.
    """
    return validated(Robot, parse_toml(text, where), where)


def validated(model: type[Checked], content: Mapping[str, Any], where: str) -> Checked:
    """`content` checked by a pydantic model; the first error in one line naming file, key, value and what is valid."""
    try:
        return model.model_validate(content)
    except ValidationError as failure:
        raise InputError(f"{where}: {_explain(model, failure)}") from failure


def _explain(model: type[BaseModel], failure: ValidationError) -> str:
    # a key nobody knows explains a missing one better than the other way round
    error = min(failure.errors(), key=lambda entry: entry["type"] != "extra_forbidden")
    key = ".".join(str(part) for part in error["loc"])
    if error["type"] == "extra_forbidden":
        return str(
            unknown_name(
                "key",
                str(error["loc"][-1]),
                getattr(_at(model, error["loc"][:-1])[0], "model_fields", {}),
                ".".join(str(part) for part in error["loc"][:-1]),
            )
        )
    valid = _at(model, error["loc"])[1]
    ending = f"; valid: {valid}" if valid else ""
    if error["type"] == "missing" and isinstance(error["loc"][-1], str):
        return f"missing key {key!r}{ending}"
    if error["type"] == "missing":
        return f"{'.'.join(str(part) for part in error['loc'][:-1])} = {list(error['input'])!r}: too few values{ending}"
    if error["type"] == "value_error":
        return ": ".join(part for part in (key, error["msg"].removeprefix("Value error, ")) if part)
    return f"{key} = {error['input']!r}: {error['msg'].lower().replace(' after validation', '')}{ending}"


def _at(model: Any, location: tuple[int | str, ...]) -> tuple[Any, str | None]:
    """Type and description of a place in a pydantic model, through lists and tables."""
    description = None
    for part in location:
        fields = getattr(model, "model_fields", {})
        if part in fields:
            description, model = fields[part].description, fields[part].annotation
        elif isinstance(part, int) and get_args(model) and hasattr(get_args(model)[0], "model_fields"):
            model = get_args(model)[0]
    return model, description

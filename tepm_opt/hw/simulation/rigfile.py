"""The rig file: what a simulated rig is made of (TOML), checked before anything is simulated."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Annotated, Literal, get_args

from pydantic import Field, InstanceOf, model_validator

from tepm_opt.data.documents import Section, read_toml, require_range, validate
from tepm_opt.errors import InputError, unknown_name
from tepm_opt.hw.simulation.devices import Dynamometer, PressureMonitor, Regulator, Stepper, TrackerDevice
from tepm_opt.hw.simulation.faults import Fault
from tepm_opt.hw.simulation.imperfections import Imperfections
from tepm_opt.models.robot import UNITS, Robot, builtin_robots, load_robot

STEP = 2.5e-4  # s, of RK4
DEFAULT = "virtual_prototype"


Engine = Literal["auto", "compiled", "mujoco"]


class SimulationSteps(Section):
    """Engine and steps of the simulation.

    `step_s` is the largest step of RK4 (robots that are too stiff or too light for it get smaller ones), `tick_s` that of the actuators'
    and frictions' states. `engine` is the compiled one where there is a C compiler and MuJoCo elsewhere ("auto"), or always one of them.
    """

    engine: Engine = "auto"
    step_s: Annotated[float, require_range(1e-6, 1e-3, "s")] = STEP
    tick_s: Annotated[float, require_range(1e-6, 2e-3, "s")] = 1e-3


class RigFile(Section):
    """A simulated rig: plain frozen data as read from a rig file.

    `parameter_factors` multiply the robot's parameters, so that the machine is not quite the one in its file. Where a rig is fitted to a
    robot by a program, `robot` is that robot itself. `faults` are those of its tracker and gauges, each a table `[[faults]]`.
    """

    name: Annotated[str, Field(min_length=1, description="any text")]
    robot: Annotated[str, Field(min_length=1, description="a built-in robot or the path of a robot file")] | InstanceOf[Robot]
    seed: Annotated[int, Field(strict=True, ge=0, le=2**32 - 1, description="0 … 2^32 − 1")] = 0
    simulation: SimulationSteps = Field(default_factory=SimulationSteps)
    parameter_factors: dict[str, Annotated[float, require_range(0.2, 5, "of the robot's value")]] = Field(default_factory=dict)
    regulator: Regulator = Field(default_factory=Regulator)
    stepper: Stepper = Field(default_factory=Stepper)
    pressure_monitor: PressureMonitor = Field(default_factory=PressureMonitor)
    dynamometer: Dynamometer = Field(default_factory=Dynamometer)
    tracker: TrackerDevice = Field(default_factory=TrackerDevice)
    imperfections: Imperfections = Field(default_factory=Imperfections)
    faults: tuple[Fault, ...] = ()

    @model_validator(mode="after")
    def _factors_name_parameters(self) -> RigFile:
        for name in self.parameter_factors:
            if name not in UNITS:
                raise unknown_name("parameter", name, UNITS, "parameter_factors")
        return self

    def with_engine(self, engine: str) -> RigFile:
        """The same rig, simulated by one of the engines.

        Raises:
            InputError: no such engine.
        """
        if engine not in get_args(Engine):
            raise unknown_name("engine", engine, get_args(Engine))
        return self.model_copy(update={"simulation": self.simulation.model_copy(update={"engine": engine})})

    @property
    def nominal(self) -> Robot:
        """The robot as its file says, which is what a controller may know.

        Raises:
            InputError: as for `load_robot`.
        """
        return self.robot if isinstance(self.robot, Robot) else load_robot(self.robot)

    @property
    def true_robot(self) -> Robot:
        """The robot with the parameters it really has."""
        robot = self.nominal
        values = robot.parameters.model_dump()
        changed = {name: values[name] * factor for name, factor in self.parameter_factors.items()}
        return robot.model_copy(update={"parameters": robot.parameters.model_copy(update=changed)})


def builtin_rigs() -> list[str]:
    """Names of the rig files that come with the package."""
    folder = resources.files("tepm_opt.hw.simulation") / "rigs"
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def load_rig_file(rig: str | Path = DEFAULT) -> RigFile:
    """A rig file by built-in name or by path; its robot may be a path beside it.

    Raises:
        InputError: no such file, not valid TOML, unknown key, value out of its range, unknown robot.
    """
    if str(rig) in builtin_rigs():
        with resources.as_file(resources.files("tepm_opt.hw.simulation") / "rigs" / f"{rig}.toml") as path:
            return _read(path)
    if not Path(rig).is_file():
        raise InputError(f"rig {str(rig)!r} is neither a file nor built in; built in: {', '.join(builtin_rigs())}")
    return _read(Path(rig))


def _read(path: Path) -> RigFile:
    file = validate(RigFile, read_toml(path), str(path))
    if isinstance(file.robot, str) and file.robot not in builtin_robots():
        file = file.model_copy(update={"robot": str(path.parent / file.robot)})
    file.true_robot  # noqa: B018  unreadable robots are refused here, not when the rig starts
    return file

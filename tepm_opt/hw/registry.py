"""Rigs by the text a person types: `--rig sim`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

from tepm_opt.data.datasets import DESCRIPTION, read_description
from tepm_opt.errors import InputError, unknown_name
from tepm_opt.hw.rig import Rig
from tepm_opt.models.robot import Robot, load_robot


@dataclass(frozen=True)
class RigKind:
    """A kind of rig: built in, or an entry point `tepm_opt.rigs` of an installed package.

    Attributes:
        name: before the colon of `--rig NAME:TARGET`.
        forms: how it is written, for messages: "sim, sim:FILE".
        open: opens one by what stands after the colon (empty where there is no colon) for a robot that shall be there; None: the rig's own.
        robot: the robot of a target, built in or the path of its file, without opening it.
        description: in a few words.
    """

    name: str
    forms: str
    open: Callable[[str, Robot | None], Rig]
    robot: Callable[[str], str] = lambda _: "kang2017"
    description: str = ""


def open_rig(text: str, robot: Robot | None = None) -> Rig:
    """The rig that a text names.

    Args:
        text: `sim` (the virtual prototype), `sim:FILE` (a rig file, or the name of a built-in one), either with `@compiled` or `@mujoco`
            after it for that engine whatever the file says, `bench` or `bench:FILE` (the single-actuator bench of such a rig),
            `replay:FILE` (a run of a data set), `serial:PORT` or `serial:PORT@BAUD` (the real robot), `ros2:HOST:PORT` (topics of ROS).
        robot: that shall be there: built-in rigs are scaled to it, a rig file must have one of its kind. The default is the rig's own, what
            `dataset.toml` beside a recording says, or kang2017.

    Raises:
        InputError: not one of these; the file is wrong or simulates a robot of another kind; or the rig's package is not installed.
    """
    kind, colon, target = text.partition(":")
    if kind.startswith("sim@") and not colon:
        kind, target = "sim", kind.removeprefix("sim")
    found = _find(kind, text)
    if colon and not target:
        raise InputError(f"rig {text!r}: nothing stands after the colon; valid: {found.forms}")
    return found.open(target, robot)


def robot_of(text: str) -> str:
    """The robot of the rig that a text names, built in or the path of its file, without opening the rig.

    Raises:
        InputError: not a rig, or its file is wrong.
    """
    kind, _, target = text.partition(":")
    return _find(kind.partition("@")[0], text).robot(target)


def rig_kinds() -> tuple[RigKind, ...]:
    """All kinds of rigs."""
    return tuple(_registry().values())


def register(kind: RigKind) -> None:
    """Add a kind at run time (the same as an entry point `tepm_opt.rigs` of an installed package).

    Raises:
        InputError: the name is taken.
    """
    if kind.name in _registry():
        raise InputError(f"rig {kind.name!r} exists already")
    _registry()[kind.name] = kind


def _find(name: str, text: str) -> RigKind:
    if name not in _registry():
        raise unknown_name("rig", text, [form for kind in rig_kinds() for form in kind.forms.split(", ")])
    return _registry()[name]


@cache
def _registry() -> dict[str, RigKind]:
    return {kind.name: kind for kind in (*BUILT_IN, *(point.load() for point in entry_points(group="tepm_opt.rigs")))}


def _split_engine(target: str) -> tuple[str, str]:
    """Split a target into a simulated rig's file and the engine asked for."""
    name, at, engine = target.rpartition("@")
    return (target, "") if not at or Path(target).is_file() or "/" in engine else (name, engine)  # of a file's name


def _open_simulated(target: str, robot: Robot | None) -> Rig:
    from tepm_opt.hw.simulation.rig import SimulatedRig
    from tepm_opt.hw.simulation.rigfile import DEFAULT, builtin_rigs, load_rig_file
    from tepm_opt.hw.simulation.scaling import scale_rig
    from tepm_opt.models.channels import channels_of

    name, engine = _split_engine(target)
    file = load_rig_file(name or DEFAULT)
    if robot is not None and (name or DEFAULT) in builtin_rigs():
        file = scale_rig(file, robot)
    elif robot is not None and channels_of(robot) != channels_of(file.nominal):
        raise InputError(
            f"rig {name}: simulates the robot {file.nominal.name!r}, the model's is {robot.name!r}; name the rig's (--robot {file.robot}), "
            f"take --rig sim, which simulates any robot, or write a rig file for yours: tepm hw rig new FILE --robot ROBOT"
        )
    try:
        return SimulatedRig(file.with_engine(engine) if engine else file)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "mujoco":
            raise
        raise InputError("rigs of MuJoCo's engine need it, and it is not installed: pip install mujoco") from error


def _simulated_robot(target: str) -> str:
    from tepm_opt.hw.simulation.rigfile import DEFAULT, load_rig_file

    return str(load_rig_file(_split_engine(target)[0] or DEFAULT).robot)


def _open_bench(target: str, robot: Robot | None) -> Rig:
    from tepm_opt.hw.simulation.bench import BenchRig

    return BenchRig(target) if target else BenchRig()


def _open_replay(target: str, robot: Robot | None) -> Rig:
    from tepm_opt.hw.replay import ReplayRig

    if not target:
        raise InputError("rig 'replay' needs the CSV file of a run: replay:FILE")
    return ReplayRig(target, robot or _recorded_robot(Path(target).parent))


def _open_serial(target: str, robot: Robot | None) -> Rig:
    from tepm_opt.hw.board.rig import open_serial

    if not target:
        raise InputError("rig 'serial' needs a port: serial:PORT, such as serial:/dev/ttyACM0; `tepm hw ports` lists them")
    return open_serial(target, robot or load_robot("kang2017"))


def _open_ros(target: str, robot: Robot | None) -> Rig:
    from tepm_opt.hw.ros.rig import open_ros

    return open_ros(target, robot)


def _recorded_robot(folder: Path) -> str:
    """The robot that the data set in a folder names, where there is one."""
    if not (folder / DESCRIPTION).is_file():
        return "kang2017"
    name = read_description(folder).robot
    return str(folder / name) if (folder / name).is_file() else name


BUILT_IN = (
    RigKind("sim", "sim, sim:FILE, sim:FILE@ENGINE", _open_simulated, _simulated_robot, "simulated robot"),
    RigKind("bench", "bench, bench:FILE", _open_bench, description="simulated bench of one actuator"),
    RigKind(
        "replay",
        "replay:FILE",
        _open_replay,
        lambda target: _recorded_robot(Path(target).parent) if target else "kang2017",
        "a run of a data set, played again",
    ),
    RigKind("serial", "serial:PORT", _open_serial, description="the real robot behind its control board"),
    RigKind("ros2", "ros2, ros2:HOST:PORT", _open_ros, description="a robot behind nodes of ROS 2, by rosbridge"),
)

"""Options that several commands share, as groups: a command takes the group, typer sees its options.

An option that is added to a group reaches every command that takes it.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self, get_type_hints

import typer
from rich.markup import escape

from tepm_opt.cli.common import refuse_far, stderr, vector
from tepm_opt.data.foreign import CSV, refuse_foreign
from tepm_opt.errors import InputError
from tepm_opt.solvers.planning.trajectories import (
    DURATION,
    END,
    SHAPES,
    START,
    ShapeParameter,
    Trajectory,
    read_trajectory,
    shape_parameters,
)

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from tepm_opt.models.compile import CompiledModel
    from tepm_opt.solvers.kinematics.ik import IkSettings

Command = Callable[..., int]


class OptionGroup:
    """Options that go together. A subclass is a dataclass whose fields are options, or says itself what its options are."""

    @classmethod
    def options(cls) -> Iterator[inspect.Parameter]:
        """The options as parameters of a command."""
        if not is_dataclass(cls):
            raise TypeError(f"{cls.__name__} must be a dataclass, or say what its options are")
        hints = get_type_hints(cls, include_extras=True)
        for entry in fields(cls):
            default = inspect.Parameter.empty if entry.default is MISSING else entry.default
            yield inspect.Parameter(entry.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=hints[entry.name])

    @classmethod
    def from_options(cls, given: Mapping[str, Any]) -> Self:
        """Build the group from the values that a person gave, by the names of its options."""
        return cls(**given)


EFFECTS = inspect.Parameter(
    "effects",
    inspect.Parameter.KEYWORD_ONLY,
    default=None,
    annotation=Annotated[
        list[Path] | None,
        typer.Option("--effects", metavar="FILE", help="Python file with effects of your own, which is run; may be repeated."),
    ],
)
"""Option of every command that takes a model."""


def spread(command: Command) -> Command:
    """The command with the options of its groups as parameters of its own, as typer wants them; with a model it takes effects, too."""
    signature = inspect.signature(command, eval_str=True)
    takes_effects = "model" in signature.parameters
    groups = {
        parameter.name: parameter.annotation
        for parameter in signature.parameters.values()
        if inspect.isclass(parameter.annotation) and issubclass(parameter.annotation, OptionGroup)
    }
    if not groups and not takes_effects:
        return command
    names = {name: [option.name for option in group.options()] for name, group in groups.items()}
    parameters = [
        option.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for parameter in signature.parameters.values()
        for option in (groups[parameter.name].options() if parameter.name in groups else (parameter,))
    ]

    if takes_effects:
        parameters = [*(p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in parameters), EFFECTS]

    def spread_out(**given: Any) -> int:
        if files := given.pop(EFFECTS.name, None):
            from tepm_opt.models.effect_files import load_effects

            load_effects(files)
        made = {name: groups[name].from_options({option: given.pop(option) for option in options}) for name, options in names.items()}
        return command(**given, **made)

    spread_out.__doc__ = command.__doc__
    spread_out.__annotations__ = {}
    spread_out.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return spread_out


@dataclass(frozen=True)
class IkOptions(OptionGroup):
    """Settings of the inverse kinematics, for every command that solves it."""

    tolerance: Annotated[
        float | None,
        typer.Option("--tolerance", metavar="M", min=1e-12, max=1e-4, help="Largest error of the tip in m.", show_default="1e-9"),
    ] = None

    def settings(self) -> IkSettings:
        """Settings of the solver; what was not given keeps its default."""
        from tepm_opt.solvers.kinematics.ik import IkSettings

        return IkSettings(**{name: value for name, value in vars(self).items() if value is not None})


@dataclass(frozen=True)
class WorkerOptions(OptionGroup):
    """Options of the workers that share independent pieces of work, for every command that has them."""

    jobs: Annotated[int | None, typer.Option("--jobs", min=1, metavar="N", help="Processes for what is independent.")] = None
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers do it instead (extra cluster).")
    ] = None

    def __post_init__(self) -> None:
        if self.jobs is not None and self.scheduler is not None:
            raise InputError("--jobs and --scheduler exclude each other: the cluster has its own workers")

    @property
    def given(self) -> bool:
        """Whether any was asked for."""
        return self.jobs is not None or self.scheduler is not None

    @contextmanager
    def open_executor(self) -> Iterator[Executor | None]:
        """Open the executor asked for; None where none was.

        Raises:
            InputError: Dask is not installed, or no scheduler answers.
        """
        from tepm_opt.jobs.executors import cluster, processes

        if not self.given:
            yield None
            return
        with cluster(self.scheduler) if self.scheduler is not None else processes(self.jobs or 1) as executor:
            yield executor


TRAJECTORY_HELP = f"{', '.join(SHAPES)} or a CSV file with x, y, z in m in frame G."


@dataclass(frozen=True)
class ShapeOptions(OptionGroup):
    """Parameters of the built-in shapes, from their registry; number of points and duration are options of their own.

    Attributes:
        given: values by name; those not given are absent.
    """

    given: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def options(cls) -> Iterator[inspect.Parameter]:
        """The parameters of all shapes as options."""
        for parameter, shapes in shape_parameters().values():
            yield _option(parameter, f"{parameter.text[0].upper()}{parameter.text[1:]} of {' and '.join(shapes)}")

    @classmethod
    def from_options(cls, given: Mapping[str, Any]) -> Self:
        """Build the group from the values that a person gave, with places as numbers.

        Raises:
            InputError: a place without its numbers.
        """
        values: dict[str, Any] = {}
        for name, (parameter, _) in _collect_trajectory_parameters().items():
            value = given.get(name)
            if value is not None:
                values[name] = vector(value, f"--{parameter.option}", parameter.count) if parameter.count > 1 else value
        return cls({**values, **({"points": given["points"]} if given.get("points") is not None else {})})

    def trajectory(self, name: str, model: CompiledModel | None = None) -> Trajectory:
        """The shape of this name, or the file's trajectory, with the options given; the others keep their defaults.

        Args:
            name: of a shape, or of a file.
            model: in whose robot's size a shape is, which a person is told; where absent it is the paper's.

        Raises:
            InputError: an option out of range or that does not fit the trajectory, an unknown shape, or as for `read_trajectory`.
        """
        for key, (parameter, _) in _collect_trajectory_parameters().items():
            if key in self.given:
                parameter.check(self.given[key], f"--{parameter.option}")
        shape = SHAPES.get(name)
        fits = {"points", "duration", *(parameter.name for parameter in shape.parameters)} if shape else {"points", "duration"}
        if misfits := sorted(self.given.keys() - fits):
            raise InputError(f"option --{_collect_trajectory_parameters()[misfits[0]][0].option} does not fit trajectory {name!r}")
        if shape is not None and model is None:
            return shape.make(**self.given)
        if shape is not None and model is not None:
            from tepm_opt.solvers.planning.scaled_paths import path_for

            made = path_for(model, name, **self.given)
            refuse_far(model, made.positions, name)
            if made.says:
                stderr.print(escape(made.says), style="dim", soft_wrap=True, highlight=False)
            return made
        if not name.endswith(".csv"):
            refuse_foreign(name, CSV)
            raise InputError(f"unknown trajectory {name!r}: valid: {', '.join(SHAPES)} or a .csv file")
        path = read_trajectory(name, self.given.get("duration"))
        if model is not None:
            refuse_far(model, path.positions, name)
        return path.resample(self.given["points"]) if "points" in self.given else path


@dataclass(frozen=True)
class TrajectoryOptions(ShapeOptions):
    """Number of points and duration of a trajectory, and the parameters of its shape."""

    @classmethod
    def options(cls) -> Iterator[inspect.Parameter]:
        """Number of points, duration, then the parameters of all shapes."""
        points = Annotated[int | None, typer.Option("--points", help="Number of points; files are resampled.")]
        yield inspect.Parameter("points", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=points)
        yield _option(DURATION, DURATION.text[0].upper() + DURATION.text[1:])
        yield from super().options()


@dataclass(frozen=True)
class PathOptions(ShapeOptions):
    """Parameters of the shape of a path whose ends are options of the command itself."""

    @classmethod
    def options(cls) -> Iterator[inspect.Parameter]:
        """The parameters of all shapes but their ends."""
        return (option for option in super().options() if option.name not in (START.name, END.name))

    def with_ends(self, start: Sequence[float] | None, end: Sequence[float] | None) -> PathOptions:
        """The same with the ends that were given."""
        ends = {START.name: start, END.name: end}
        return PathOptions({**self.given, **{name: value for name, value in ends.items() if value is not None}})


def _collect_trajectory_parameters() -> dict[str, tuple[ShapeParameter, tuple[str, ...]]]:
    """Collect all parameters of trajectories but the number of points, in the order of the options."""
    return {DURATION.name: (DURATION, ()), **shape_parameters()}


def _option(parameter: ShapeParameter, text: str) -> inspect.Parameter:
    """An option for a parameter: a number, or numbers by commas."""
    place = parameter.count > 1
    numbers = "x,y,z" if parameter.count == 3 else f"{parameter.count} numbers"
    unit = f"{numbers} in {parameter.unit}" if place else parameter.unit
    info = typer.Option(f"--{parameter.option}", help=f"{text.rstrip(',')}, {unit}.")
    annotation = Annotated[str | None if place else float | None, info]  # type: ignore[valid-type]
    return inspect.Parameter(parameter.name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation)

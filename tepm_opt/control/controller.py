"""Interface of controllers: protocol, log entry, options and description."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol, TypeVar, runtime_checkable

from tepm_opt.control.references.reference import Reference
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.models.compile import CompiledModel

Value = float | str
"""A value of a column of the log."""
Option = bool | str
"""A value of an option of the command line."""


@dataclass(frozen=True)
class Telemetry:
    """Log entry of a controller about itself.

    Attributes:
        columns: values at the last sample by the name of their column in the log; the same names at every sample.
        fallbacks: number of steps so far that went on with something older, by the reason.
        doubts: what does not make sense now and a person should know, a sentence each, by what it is about.
    """

    columns: Mapping[str, Value] = field(default_factory=dict)
    fallbacks: Mapping[str, int] = field(default_factory=dict)
    doubts: Mapping[str, str] = field(default_factory=dict)


class Controller(Protocol):
    """A controller: follows a reference, sample by sample."""

    @property
    def reference(self) -> Reference:
        """The reference that the controller follows."""
        ...

    def start(self) -> Command:
        """Set points under which the robot shall rest before the first sample."""
        ...

    def command(self, sample: Sample) -> Command:
        """Set points for a sample."""
        ...

    def telemetry(self) -> Telemetry:
        """Log entry of the last sample."""
        ...


@runtime_checkable
class Prepares(Protocol):
    """A controller part of whose work needs no sample and can be done while the rig goes on."""

    def prepare(self) -> None:
        """Do what the next sample is not needed for, should it come a period after the last one; best as soon as a command is sent."""
        ...


class ControllerSettings(Protocol):
    """Settings of one kind of controller."""

    @property
    def asked(self) -> dict[str, Option]:
        """Options of the command line with which these settings were made, by name; they stand in the summary."""
        ...

    def in_real_time(self, period: float) -> ControllerSettings:
        """The same settings for a rig whose time does not wait for a step, with control periods in s."""
        ...


Own = TypeVar("Own", bound=ControllerSettings)


def own_settings(settings: ControllerSettings, kind: type[Own]) -> Own:
    """Settings of a controller's own kind.

    Raises:
        InputError: settings of another controller.
    """
    if not isinstance(settings, kind):
        raise InputError(f"settings: {settings!r}; valid: {kind.__name__}")
    return settings


@dataclass(frozen=True)
class NoSettings:
    """Settings of a controller of which nothing can be asked."""

    @property
    def asked(self) -> dict[str, Option]:
        """No options: always empty."""
        return {}

    def in_real_time(self, period: float) -> NoSettings:
        """These settings, unchanged: there is nothing that real time changes."""
        return self


def no_settings(options: Mapping[str, Option]) -> NoSettings:
    """Settings of a controller that has no options, whatever was given."""
    return NoSettings()


@dataclass(frozen=True)
class ControllerKind:
    """A kind of controller: how it is named and made. One in a module of this folder is all that a new controller takes.

    Attributes:
        name: as the command line and the summary have it.
        title: name in figures.
        description: continues "the …" in help texts and messages.
        make: a controller for a compiled model, a reference and settings.
        options: names of the options of `tepm mpc` that it understands.
        settings: settings for the values of these options that were given, by name; `InputError` for a value that there is not.
        jumps: whether its target jumps from point to point, as the paper's; else it moves there smoothly.
    """

    name: str
    title: str
    description: str
    make: Callable[[CompiledModel, Reference, ControllerSettings], Controller]
    options: tuple[str, ...] = ()
    settings: Callable[[Mapping[str, Option]], ControllerSettings] = no_settings
    jumps: bool = False

    def __repr__(self) -> str:
        return f"ControllerKind({self.name!r}, {self.title!r}, options={self.options})"

"""All kinds of controllers. A module of `baselines`, an entry point `tepm_opt.controllers` or `register` adds one; no list names them."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from functools import cache
from importlib.metadata import entry_points

from tepm_opt.control import baselines
from tepm_opt.control.controller import ControllerKind, ControllerSettings, Option
from tepm_opt.control.mpc import controller as mpc
from tepm_opt.errors import InputError, unknown_name

DEFAULT = "mpc"
"""The controller that runs where none is named."""


@cache
def _registry() -> dict[str, ControllerKind]:
    modules = [mpc, *(importlib.import_module(f"{baselines.__name__}.{info.name}") for info in pkgutil.iter_modules(baselines.__path__))]
    kinds = [kind for module in modules for kind in vars(module).values() if isinstance(kind, ControllerKind)]
    kinds += [point.load() for point in entry_points(group="tepm_opt.controllers")]
    return {kind.name: kind for kind in sorted(kinds, key=lambda kind: (kind.name != DEFAULT, kind.name))}


def controllers() -> tuple[ControllerKind, ...]:
    """All kinds of controllers: the default one, then the others by name."""
    return tuple(_registry().values())


def find_controller(name: str) -> ControllerKind:
    """The kind of this name.

    Raises:
        InputError: no such controller.
    """
    if name not in _registry():
        raise unknown_name("controller", name, _registry())
    return _registry()[name]


def settings_of(kind: ControllerKind, options: Mapping[str, Option]) -> ControllerSettings:
    """Settings of a controller for options of the command line.

    Args:
        kind: of the controller.
        options: those that were given, by name.

    Raises:
        InputError: an option that belongs to another controller or to none, or a value that it does not have.
    """
    for option in options:
        if option not in kind.options:
            owners = " or the ".join(other.description for other in controllers() if option in other.options)
            if not owners:
                raise unknown_name("option", option, kind.options)
            raise InputError(f"--{option} belongs to the {owners}; leave it out with --controller {kind.name}")
    return kind.settings(options)


def register(kind: ControllerKind) -> None:
    """Add a kind at run time (the same as an entry point `tepm_opt.controllers` of an installed package).

    Raises:
        InputError: the name is taken.
    """
    if kind.name in _registry():
        raise InputError(f"controller {kind.name!r} exists already")
    _registry()[kind.name] = kind

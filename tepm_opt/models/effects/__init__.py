"""All known effects. A module of this folder, an entry point `tepm_opt.effects` or `register` adds one; no list names them."""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache
from importlib.metadata import entry_points

from tepm_opt.errors import InputError, unknown_name
from tepm_opt.models.effect import Effect
from tepm_opt.models.effects.gravity import Gravity
from tepm_opt.models.effects.known_loads import KnownLoads

__all__ = ["STANDARD", "effects", "find_effect", "register", "unregister"]

STANDARD: tuple[Effect, ...] = (Gravity(), KnownLoads())
"""Effects that every model carries; model files do not list them."""


@cache
def _registry() -> dict[str, Effect]:
    modules = [importlib.import_module(f"{__name__}.{info.name}") for info in pkgutil.iter_modules(__path__)]
    kinds = [kind for module in modules for kind in vars(module).values() if isinstance(kind, type) and kind.__module__ == module.__name__]
    kinds += [point.load() for point in entry_points(group="tepm_opt.effects")]
    found = {kind.name: kind() for kind in kinds if issubclass(kind, Effect) and kind is not Effect}
    return {name: found[name] for name in sorted(found) if name not in {effect.name for effect in STANDARD}}


def effects() -> tuple[Effect, ...]:
    """All effects a model can be given, by name."""
    return tuple(effect for _, effect in sorted(_registry().items()))


def find_effect(name: str, where: str = "") -> Effect:
    """The effect of this name.

    Raises:
        InputError: no such effect; `where` names the file in the message.
    """
    if name not in _registry():
        raise unknown_name("effect", name, _registry(), where)
    return _registry()[name]


def register(effect: Effect) -> None:
    """Add an effect at run time (the same as an entry point `tepm_opt.effects` of an installed package).

    Raises:
        InputError: the name is taken.
    """
    if effect.name in _registry():
        raise InputError(f"effect {effect.name!r} exists already")
    _registry()[effect.name] = effect


def unregister(name: str) -> None:
    """Take an effect away that `register` added; one that is not there is none."""
    _registry().pop(name, None)

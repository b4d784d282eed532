"""Modules, methods and other names by those of version 0.2, which go with version 0.4."""

from __future__ import annotations

import pkgutil
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any


class _RenamedModules(MetaPathFinder, Loader):
    """Import modules of one package by their old names, with a DeprecationWarning that tells the new one."""

    def __init__(self, package: str, names: Mapping[str, str]) -> None:
        self._package, self._names = package, names

    def find_spec(self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        new = self._new_name(fullname)
        package = self._names.get(fullname.removeprefix(f"{self._package}."), "").endswith(".*")
        return ModuleSpec(fullname, self, loader_state=new, is_package=package) if new else None

    def _new_name(self, fullname: str) -> str | None:
        if not fullname.startswith(f"{self._package}."):
            return None
        old = fullname.removeprefix(f"{self._package}.")
        first, _, rest = old.partition(".")
        if self._names.get(first, "").endswith(".*"):
            return ".".join(filter(None, (self._package, self._names[first][:-2], rest)))
        return f"{self._package}.{self._names[old]}" if old in self._names else None

    def exec_module(self, module: ModuleType) -> None:
        new = module.__spec__.loader_state if module.__spec__ else module.__name__
        warnings.warn(f"{module.__name__} is now {new}; the old name goes with version 0.4", DeprecationWarning, stacklevel=6)
        module.__dict__.update({name: value for name, value in vars(import_module(new)).items() if not name.startswith("__")})


def rename_modules(package: str, names: Mapping[str, str]) -> None:
    """Let modules of a package be imported by their old names as well.

    Args:
        package: full name.
        names: new names by the old ones, both within the package; a new one that ends in `.*` is a package with all its modules.
    """
    sys.meta_path.append(_RenamedModules(package, names))


def find_renamed(package: str, name: str, names: Mapping[str, str]) -> Any:
    """Object of a package by its old name, with a DeprecationWarning that tells the new one; for the package's `__getattr__`.

    Args:
        package: full name.
        name: asked for.
        names: new names by the old ones, both within the package.

    Raises:
        AttributeError: no such name.
    """
    if name not in names:
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    new = f"{package}.{names[name]}"
    warnings.warn(f"{package}.{name} is now {new}; the old name goes with version 0.4", DeprecationWarning, stacklevel=3)
    return pkgutil.resolve_name(new)


class RenamedMethod:
    """Method of a class by its old name, with a DeprecationWarning that tells the new one.

    Args:
        new: name of the method.
    """

    def __init__(self, new: str) -> None:
        self._new = new

    def __set_name__(self, owner: type, name: str) -> None:
        self._old = name

    def __get__(self, instance: object, owner: type) -> Callable[..., Any]:
        message = f"{owner.__name__}.{self._old} is now {owner.__name__}.{self._new}; the old name goes with version 0.4"
        warnings.warn(message, DeprecationWarning, stacklevel=2)
        return getattr(owner if instance is None else instance, self._new)


def adopt_renamed_hook(kind: type, old: str, new: str) -> None:
    """Let a new class override a hook by its old name, with a DeprecationWarning; to be called by its base's `__init_subclass__`."""
    if old in vars(kind) and new not in vars(kind):
        message = f"{kind.__name__}.{old} is now {kind.__name__}.{new}; the old name goes with version 0.4"
        warnings.warn(message, DeprecationWarning, stacklevel=3)
        setattr(kind, new, vars(kind)[old])

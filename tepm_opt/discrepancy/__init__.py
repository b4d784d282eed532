"""The discrepancy workflow: find the gap between model and data, name the missing effect, add it, show the gap shrink.

Rooms: `pipeline` (the stages), `problem`, `preparation`, `selection`, `assessment`, `experiments`, `adapters` (plants), `laws`, `symbolic`
(laws that no library has) and `reporting`.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

RENAMED = {
    **{name: f"adapters.{name}" for name in ("equations", "callable_plant", "casadi_plant", "network")},
    "library": "laws",
    "workflow": "pipeline",
}
"""Modules that plant files import, by their names in version 0.2."""


class _Renamed(MetaPathFinder, Loader):
    """Import a module by its name of version 0.2, with a DeprecationWarning that tells the new one."""

    def find_spec(self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        package, _, name = fullname.rpartition(".")
        known = package == f"{__name__}.library" or (package == __name__ and name in RENAMED)
        return ModuleSpec(fullname, self, is_package=name == "library") if known else None

    def exec_module(self, module: ModuleType) -> None:
        first, *rest = module.__name__.removeprefix(f"{__name__}.").split(".")
        new = ".".join((__name__, RENAMED[first], *rest))
        warnings.warn(f"{module.__name__} is now {new}; the old name goes with version 0.4", DeprecationWarning, stacklevel=6)
        module.__dict__.update({name: value for name, value in vars(import_module(new)).items() if not name.startswith("__")})


sys.meta_path.append(_Renamed())

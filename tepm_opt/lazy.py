"""Namespaces whose names are imported when they are first used, so that a program starts at once (PEP 562)."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path


def attach(package: str, file: str) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """Make `__getattr__`, `__dir__` and `__all__` of a package from the stub beside it, `__init__.pyi`.

    The stub holds nothing but `from … import A as A`; type checkers and editors read the same file.

    Args:
        package: its `__name__`.
        file: its `__file__`.
    """
    tree = ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8"))
    homes = {name.name: node.module for node in tree.body if isinstance(node, ast.ImportFrom) and node.module for name in node.names}

    def get(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        found = getattr(import_module(homes[name]), name)
        setattr(sys.modules[package], name, found)  # at once the next time
        return found

    names = sorted(homes)
    return get, lambda: names, names

"""Python files that a person writes: run, and told what is wrong with them in a line."""

from __future__ import annotations

import importlib.util
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from tepm_opt.errors import InputError

Wanted = TypeVar("Wanted")


def run_file(path: Path, name: str, valid: str, wanted: Callable[[ModuleType], Wanted]) -> Wanted:
    """Run a Python file and take what is wanted from its module; it may import what stands beside it.

    Args:
        path: of the file.
        name: of the module.
        valid: what a valid file is, for the message where there is none.
        wanted: takes it from the module; may run more of the file.

    Raises:
        InputError: no such file, or it fails; the message says where.
    """
    spec = importlib.util.spec_from_file_location(name, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise InputError(f"{path}: no such Python file; valid: {valid}")
    module = importlib.util.module_from_spec(spec)
    folder, before, keeps_nothing = path.resolve().parent, set(sys.modules), sys.dont_write_bytecode
    sys.path.insert(0, str(folder))
    sys.dont_write_bytecode = True  # Python takes kept code for current where a file changed within a second and kept its size
    try:
        spec.loader.exec_module(module)
        return wanted(module)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (Exception, SystemExit) as error:
        raise InputError(f"{path}: {_failure(error, path)}") from error
    finally:
        sys.dont_write_bytecode = keeps_nothing
        sys.path.remove(str(folder))
        for other in set(sys.modules) - before:  # what stands beside it is read anew the next time
            if Path(getattr(sys.modules[other], "__file__", None) or "").parent == folder:
                del sys.modules[other]


def _failure(error: BaseException, path: Path) -> str:
    """Describe in a line an error and its place in the file."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    line, text = next(reversed(lines), None), " ".join(str(error).split())
    if isinstance(error, SyntaxError) and error.filename == str(path):
        line, text = error.lineno, error.msg
    return f"{f'line {line}: ' if line else ''}{type(error).__name__}: {text}"

"""Functions and C texts of models between runs: CasADi writes those of a model with all effects in 5 s, they are read in 0.1 s.

They are kept beside the libraries under the hash of all they are made from: robot, effects, and the sources of this package. Values of
parameters are arguments of the functions. Models with effects from elsewhere are written anew, as nobody knows what their code imports.
"""

from __future__ import annotations

import hashlib
import json
import pickle
import platform
import zlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TypeVar

from tepm_opt.errors import InputError
from tepm_opt.models.backends import store
from tepm_opt.models.backends.ccode import Texts, Unit
from tepm_opt.models.effects import find_effect
from tepm_opt.models.model import Model

PACKAGE = Path(__file__).parents[1]
SUFFIX = ".functions"
Functions = TypeVar("Functions")


def read_or_write(
    stem: str, model: Model, write: Callable[[Model], Functions], unit_of: Callable[[Functions], Unit]
) -> tuple[Functions, Texts]:
    """A model's functions and their C, as they were kept, or written now and kept.

    Args:
        stem: with which the name of the file begins.
        model: with its effects.
        write: writes the functions.
        unit_of: what is compiled of them.
    """
    if not all(type(find_effect(effect.name)).__module__.startswith("tepm_opt.models.") for effect in model.effects):
        functions = write(model)
        return functions, unit_of(functions).texts
    made_from = [stem, model.robot.model_dump_json(), json.dumps([(effect.name, effect.detail) for effect in model.effects]), _sources()]
    name = f"{stem}_written-{hashlib.sha256(chr(10).join(made_from).encode()).hexdigest()[:24]}"
    with store.opened_folder() as folder:
        content = store.read_file(folder, name, SUFFIX)
        if content is not None:  # whole and the own user's, like libraries
            return pickle.loads(zlib.decompress(content))
        functions = write(model)
        texts = unit_of(functions).texts
        with suppress(InputError, OSError):  # a full disk
            store.keep(folder, name, zlib.compress(pickle.dumps((functions, texts)), 1), SUFFIX)
    return functions, texts


@cache
def _sources() -> str:
    """Hash of the sources of models, and of what reads and writes them."""
    files = sorted(path for path in PACKAGE.rglob("*") if path.suffix in (".py", ".c"))
    digest = hashlib.sha256("\n".join((version("casadi"), platform.python_version())).encode())
    for path in files:
        digest.update(path.relative_to(PACKAGE).as_posix().encode() + b"\n" + path.read_bytes())
    return digest.hexdigest()

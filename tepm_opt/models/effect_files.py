"""Effects of a person's own: Python files whose classes are registered beside the package's effects."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

from tepm_opt.data.python_files import run_file
from tepm_opt.errors import InputError
from tepm_opt.models.effect import Effect
from tepm_opt.models.effects import effects, register, unregister

VALID = "a file with a subclass of tepm_opt.models.effect.Effect"
_loaded: dict[str, str] = {}
_files: dict[str, Path] = {}


def load_effects(files: Iterable[str | Path]) -> tuple[Effect, ...]:
    """Register the effects that Python files define; the files are run. An effect of an earlier file gives way to one of its name.

    Raises:
        InputError: no such file, it fails, it has no effect, an effect lacks something or its name is taken.
    """
    return tuple(effect for file in files for effect in _of_file(Path(file)))


def unload_effect(name: str) -> None:
    """Take an effect of a file away."""
    _files.pop(name, None)
    if _loaded.pop(name, None) is not None:
        unregister(name)


def loaded_effects() -> str:
    """Fingerprint of the loaded effects, which changes with the files' contents."""
    return hashlib.sha256(repr(sorted(_loaded.items())).encode()).hexdigest() if _loaded else ""


def loaded_files() -> tuple[Path, ...]:
    """The files whose effects are registered."""
    return tuple(dict.fromkeys(_files.values()))


def _of_file(path: Path) -> list[Effect]:
    found = run_file(path, f"effects_of_{path.stem}", VALID, _effects)
    for effect in found:
        if effect.name in _loaded:
            unregister(effect.name)
        if effect.name in {other.name for other in effects()}:
            raise InputError(f"{path}: effect {effect.name!r} exists already; valid: a name of its own")
        register(effect)
        _loaded[effect.name] = path.read_text(encoding="utf-8")
        _files[effect.name] = path
    return found


def _effects(module: ModuleType) -> list[Effect]:
    """Effects that a module defines.

    Raises:
        InputError: none, or one that lacks what every effect has.
    """
    kinds = [kind for kind in vars(module).values() if isinstance(kind, type) and kind.__module__ == module.__name__]
    found = [kind() for kind in kinds if issubclass(kind, Effect)]
    if not found:
        raise InputError(f"has no effect; valid: {VALID}")
    for effect in found:
        _check(effect)
    return found


def _check(effect: Effect) -> None:
    """Refuse an effect that lacks what every effect has.

    Raises:
        InputError: naming what it lacks.
    """
    kind = type(effect).__name__
    for field in ("name", "explains", "reference"):
        if not isinstance(getattr(effect, field, None), str) or not getattr(effect, field):
            raise InputError(f"{kind} has no {field}; valid: a text")
    if not effect.name.isidentifier() or effect.name != effect.name.lower():
        raise InputError(f"{kind}: name {effect.name!r}; valid: small letters, digits and underscores")
    if effect.detail not in (None, "actuator", "point"):
        raise InputError(f"{kind}: detail {effect.detail!r}; valid: 'actuator', 'point' or None")
    if not effect.parameters or all(p.null == p.probe for p in effect.parameters):
        raise InputError(f"{kind} has no parameter whose probe differs from its null; valid: at least one")
    for p in effect.parameters:
        if not (p.low <= p.null <= p.high and p.low <= p.probe <= p.high):
            raise InputError(f"{kind}: parameter {p.name!r}: null {p.null:g} or probe {p.probe:g} outside {p.low:g} … {p.high:g}")

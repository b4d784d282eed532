"""Parameters of a machine that a plant file describes: those known within a range, and those of effects that may be missing."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf, isfinite
from typing import Any, Self

from tepm_opt.data.run import Run
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.errors import InputError, unknown_name
from tepm_opt.solvers.mechanics.plant import Free


@dataclass
class MachineDescription:
    """A machine under construction: its parameters and the effects that may be missing in it.

    Attributes:
        name: of the machine.
    """

    name: str
    _free: dict[str, Free] = field(default_factory=dict, init=False, repr=False)
    _known: list[str] = field(default_factory=list, init=False, repr=False)
    _grouped: dict[str, tuple[str, ...]] = field(default_factory=dict, init=False, repr=False)
    _candidates: list[Candidate] = field(default_factory=list, init=False, repr=False)

    @property
    def known(self) -> Callable[..., Any]:
        """`parameter`, by its name of version 0.2."""
        warnings.warn("m.known(…) is now m.parameter(…); the old name goes with version 0.4", DeprecationWarning, stacklevel=2)
        return self.parameter

    def parameter(
        self, name: str, value: float, unit: str = "1", within: float = 0.2, low: float | None = None, high: float | None = None,
        std: float = inf, groups: Sequence[str] = (),
    ) -> Any:  # fmt: skip
        """Add a parameter that is known within a part of its value, or between two values.

        Args:
            name: of the parameter.
            value: the best guess.
            unit: of it.
            within: half-width of its range, in parts of the value.
            low, high: the range, instead.
            std: standard deviation of the guess, of a normal distribution within the range; without limits the range is ten of them.
            groups: of runs (`group` in dataset.toml), each of which has a value of its own: "name[group]". A simulation gets that of
                its run under the name.

        Returns:
            Its symbol in equations; None where a function simulates the machine.

        Raises:
            InputError: the name is taken, the value is outside its range, or there is no range.
        """
        self._require_new(name, self._grouped)
        off = 10 * std if isfinite(std) else abs(value) * within
        low, high = value - off if low is None else low, value + off if high is None else high
        if not low < high:
            raise InputError(f"{name} has no range ({low:g} … {high:g}); valid: low and high, low below high")
        if not low <= value <= high:
            raise InputError(f"{name} = {value:g} {unit} is outside its range; valid: {low:g} … {high:g}")
        scale = std if isfinite(std) else (high - low) / 4 if isfinite(high - low) else abs(value)
        scale, mean = max(scale, 1e-3 * abs(value)) or 1.0, value if isfinite(std) else 0.0
        names = [f"{name}[{group}]" for group in groups] or [name]
        self._add_free([Free(full, unit, value, low, high, scale, mean, std) for full in names])
        self._known += names
        if groups:
            self._grouped[name] = tuple(groups)
        return self._add_symbol(name)

    def _add_symbol(self, name: str) -> Any:
        """Add the symbol of a parameter, where equations need one."""

    def _add_free(self, free: Sequence[Free]) -> None:
        for each in free:
            self._require_new(each.name, self._free)
            self._free[each.name] = each

    def _require_new(self, name: str, taken: Mapping[str, object]) -> None:
        if name in taken:
            raise InputError(f"{self.name}: {name!r} is there twice; valid: a name of its own for each")


@dataclass(frozen=True, eq=False)
class DescribedPlant:
    """A machine with its parameters: the common part of all kinds of plant files, see `plant.SearchablePlant`.

    Attributes:
        name: of the machine.
        signals: inputs and outputs.
        parameters: by full name with their ranges; `start` is the value they have.
        known: names of the parameters that are known within their ranges.
        candidates: effects that may be missing.
        grouped: names of the parameters that groups of runs have for themselves, each with its groups.
    """

    name: str
    signals: Signals
    parameters: Mapping[str, Free]
    known: tuple[str, ...]
    candidates: tuple[Candidate, ...]
    grouped: Mapping[str, tuple[str, ...]]

    equilibria = None

    @property
    def without_candidates(self) -> Self:
        """The machine itself: candidates at their null values cost nothing."""
        return self

    @property
    def values(self) -> dict[str, float]:
        """Values of all parameters by full name."""
        return {name: free.start for name, free in self.parameters.items()}

    def with_values(self, values: Mapping[str, float]) -> Self:
        """The same machine with other values of some parameters."""
        changed = {name: replace(self.parameters[name], start=value) for name, value in values.items()}
        return replace(self, parameters={**self.parameters, **changed})

    def free(self, names: Sequence[str]) -> tuple[Free, ...]:
        """Parameters by full name with their ranges.

        Raises:
            InputError: no such parameter; a value outside its range.
        """
        for name in names:
            if name not in self.parameters:
                raise unknown_name("parameter", name, self.parameters)
            free = self.parameters[name]
            if not free.low - 1e-9 * free.scale <= free.start <= free.high + 1e-9 * free.scale:
                raise InputError(f"parameter {name} = {free.start:g} is outside its range; valid: {free.low:g} … {free.high:g}")
        return tuple(self.parameters[name] for name in names)

    def of_run(self, run: Run) -> dict[str, str]:
        """Full names of the parameters of a run, by the names that its machine has for them; in the parameters' order.

        Raises:
            InputError: the run is of no known group.
        """
        found = {full: (full, run.group) for full in self.parameters}
        for name, groups in self.grouped.items():
            if run.group not in groups:
                raise unknown_name("group", run.group, groups, f"{run.file}: {name}")
            found |= {f"{name}[{group}]": (name, group) for group in groups}
        return {name: full for full, (name, group) in found.items() if group == run.group}

    def corrected_model(self, kept: Sequence[Candidate]) -> dict[str, float]:
        """Values by full name of the known parameters and those of these effects."""
        names = [*self.known, *(name for candidate in kept for name in candidate.parameters)]
        return {name: self.parameters[name].start for name in names}

"""Generated C: kernels and the loops around them become a shared library, kept under the hash of all it depends on."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import resources

import casadi as ca

from tepm_opt.models.backends import compiler
from tepm_opt.models.backends.kernels import PREAMBLE, Kernel

FLAGS = (
    *("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros", "-fassociative-math"),
    "-freciprocal-math",  # edges are divided by their lengths, component by component
    "-fno-semantic-interposition",  # calls within the library are calls, or nothing, and no look-ups
)
KERNEL_FLAGS = ("-O1", "-fira-region=one", "-fira-algorithm=priority", *FLAGS[1:])
"""Flags of kernels. They are straight lines: -O3 finds nothing in them to make faster, and takes three times as long."""


@dataclass(frozen=True)
class Unit:
    """What is compiled together: kernels, sizes and index arrays, and the loops around them.

    Attributes:
        kernels: CasADi functions; of a Jacobian `<name>_by` the C text also gets `<name>_by_nnz`, `…_row` and `…_col`.
        sizes: macros by name; LANES is the number of doubles in a vector.
        arrays: static arrays of integers by name.
        loops: names of the C files in this package, one after the other.
        symbols: functions that are called from outside.
        lanes: kernels that come as `<name>_lanes`, which takes and returns vectors: several segments at once.
        stem: with which the name of the library begins.
    """

    kernels: Mapping[str, ca.Function]
    sizes: Mapping[str, float]
    arrays: Mapping[str, Sequence[int]]
    loops: tuple[str, ...]
    symbols: tuple[str, ...]
    lanes: tuple[str, ...] = ()
    stem: str = "time_stepping"

    @cached_property
    def source(self) -> str:
        """The C text of all together, in one file."""
        written = self._written.values()
        return "\n".join(
            ("#define FORMULAS static", self._start, *(part for kernel in written for part in (kernel.formulas, kernel.call)), *self._loops)
        )

    @cached_property
    def parts(self) -> dict[str, str]:
        """The same as texts that are compiled apart: the formulas of each kernel by its name, and all the rest, `LOOPS`."""
        start = f"{_HIDDEN}\n{self._start}"
        found = {name: f"{start}\n{kernel.formulas}" for name, kernel in self._written.items()}
        found[LOOPS] = "\n".join((start, *(kernel.call for kernel in self._written.values()), *self._loops))
        return found

    @cached_property
    def _written(self) -> dict[str, Kernel]:
        return {name: Kernel(function, name in self.lanes) for name, function in self.kernels.items()}

    @property
    def _start(self) -> str:
        return f"#define LANES {self.sizes['LANES']}\n{PREAMBLE}"

    @cached_property
    def _loops(self) -> list[str]:
        """Sizes, index arrays, and the loops."""
        sizes: dict[str, float] = {name: value for name, value in self.sizes.items() if name != "LANES"}
        arrays = dict(self.arrays)
        for name, function in self.kernels.items():
            if name.endswith("_by"):
                pattern = function.sparsity_out(0)
                sizes[f"{name}_nnz"] = pattern.nnz()
                arrays |= {f"{name}_row": pattern.row(), f"{name}_col": pattern.get_col()}
        lines = [f"#define {name} {value}" for name, value in sizes.items()]
        lines += [f"static const int {name}[] = {{{', '.join(map(str, values)) or '0'}}};" for name, values in arrays.items()]
        return [*lines, *((resources.files("tepm_opt.models.backends") / name).read_text(encoding="utf-8") for name in self.loops)]


LOOPS = "loops"
"""Name of the part that has no kernel."""
_HIDDEN = '#define FORMULAS __attribute__((visibility("hidden")))'


def build(unit: Unit) -> ctypes.CDLL | None:
    """The library of a unit, kept or compiled; None (and one warning) where that is not possible."""
    instead = "CasADi's virtual machine is used, with the same results, some 50 times slower"
    parts = [compiler.Part(name, text, FLAGS if name == LOOPS else KERNEL_FLAGS) for name, text in unit.parts.items()]
    return compiler.build(parts, unit.stem, unit.symbols, instead)

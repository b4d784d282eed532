"""Generated C: kernels and the loops around them become a shared library, kept under the hash of all it depends on."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import resources

import casadi as ca

from tepm_opt.models.backends import compiler, store
from tepm_opt.models.backends.kernels import PREAMBLE, Kernel

FLAGS = (
    *("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros", "-fassociative-math"),
    "-freciprocal-math",  # edges are divided by their lengths, component by component
    "-fno-semantic-interposition",  # calls within the library are calls, or nothing, and no look-ups
)
_ALLOCATION = ("-fira-region=one", "-fira-algorithm=priority")  # of registers: quick, and as good in straight lines
SEGMENT_FLAGS = ("-O2", *_ALLOCATION, *FLAGS[1:])
"""Flags of kernels of a segment, which take most of the time: -O3 finds nothing more in straight lines."""
KERNEL_FLAGS = ("-O1", *_ALLOCATION, *FLAGS[1:])
"""Flags of the other kernels: -O2 takes twice as long to compile some, for a tenth of the time of a call."""


@dataclass(frozen=True)
class Unit:
    """Parts that are compiled together: kernels, sizes and index arrays, and the loops around them.

    Attributes:
        kernels: CasADi functions; of a Jacobian `<name>_by` the C text also gets `<name>_by_nnz`, `…_row` and `…_col`.
        sizes: macros by name; LANES is the number of doubles in a vector.
        counts: numbers that effects change. For each, and each `…_nnz`, the C text also gets `<name>_ROOM`, the next power of two: for
            lengths of arrays, so that one more effect seldom changes the loops.
        arrays: arrays of integers by name.
        loops: names of the C files in this package, one after the other.
        symbols: functions that are called from outside.
        lanes: kernels that come as `<name>_lanes`, which takes and returns vectors: several segments at once.
        stem: with which the name of the library begins.
    """

    kernels: Mapping[str, ca.Function]
    sizes: Mapping[str, float]
    counts: Mapping[str, int]
    arrays: Mapping[str, Sequence[int]]
    loops: tuple[str, ...]
    symbols: tuple[str, ...]
    lanes: tuple[str, ...] = ()
    stem: str = "time_stepping"

    @cached_property
    def source(self) -> str:
        """The C text of all together, in one file."""
        kernels = (text for kernel in self._kernel_texts.values() for text in (*kernel.formulas, kernel.call))
        linked = ("FORMULAS static __attribute__((noinline))", "CALL static inline", "TABLE static const int")
        return "\n".join((*(f"#define {how}" for how in linked), self._start, *kernels, *self._tables.values(), *self._loops))

    @cached_property
    def parts(self) -> dict[str, str]:
        """The same as texts that are compiled apart: formulas by kernel, `TABLES` of what a model is beside them, and the `LOOPS`."""
        hidden = '__attribute__((visibility("hidden")))'
        linked = (f"FORMULAS {hidden}", f"CALL {hidden}", f"TABLE {hidden} const int")
        start = "\n".join((*(f"#define {how}" for how in linked), self._start))
        found = {
            f"{name}_{k}" if k else name: f"{start}\n{text}"
            for name, kernel in self._kernel_texts.items()
            for k, text in enumerate(kernel.formulas)
        }
        found[TABLES] = "\n".join((start, *(kernel.call for kernel in self._kernel_texts.values()), *self._tables.values()))
        declared = (f"{kernel.declared};" for kernel in self._kernel_texts.values())
        found[LOOPS] = "\n".join((start, *declared, *(f"extern TABLE {name};" for name in self._tables), *self._loops))
        return found

    @property
    def texts(self) -> Texts:
        """The same with what loading the library needs, as plain data."""
        try:
            return Texts(self.parts, self.stem, self.symbols)
        except ValueError as error:  # an effect that is no mere arithmetic
            return Texts({}, self.stem, self.symbols, str(error))

    @cached_property
    def _kernel_texts(self) -> dict[str, Kernel]:
        return {name: Kernel(function, name in self.lanes) for name, function in self.kernels.items()}

    @property
    def _start(self) -> str:
        return f"#define LANES {self.sizes['LANES']}\n{PREAMBLE}"

    @cached_property
    def _patterns(self) -> dict[str, ca.Sparsity]:
        return {name: function.sparsity_out(0) for name, function in self.kernels.items() if name.endswith("_by")}

    @property
    def _all_counts(self) -> dict[str, int]:
        return {**self.counts, **{f"{name}_nnz": pattern.nnz() for name, pattern in self._patterns.items()}}

    @cached_property
    def _tables(self) -> dict[str, str]:
        """Definitions of the integers that one more effect or another mount changes, by what is declared of them."""
        arrays = dict(self.arrays)
        for name, pattern in self._patterns.items():
            arrays |= {f"{name}_row": pattern.row(), f"{name}_col": pattern.get_col()}
        found = {name: f"TABLE {name} = {value};" for name, value in self._all_counts.items()}
        return found | {f"{name}[]": f"TABLE {name}[] = {{{', '.join(map(str, values)) or '0'}}};" for name, values in arrays.items()}

    @cached_property
    def _loops(self) -> list[str]:
        """Sizes and the loops."""
        sizes = {**self.sizes, **{f"{name}_ROOM": 1 << value.bit_length() for name, value in self._all_counts.items()}}
        lines = [f"#define {name} {value}" for name, value in sizes.items() if name != "LANES"]
        return [*lines, *((resources.files("tepm_opt.models.backends") / name).read_text(encoding="utf-8") for name in self.loops)]


LOOPS, TABLES = "loops", "tables"
"""Names of the parts that have no formulas."""


@dataclass(frozen=True)
class Texts:
    """The C of a unit.

    Attributes:
        parts: texts that are compiled apart, by name.
        stem, symbols: see `Unit`.
        error: why there is no C, empty where there is.
    """

    parts: Mapping[str, str]
    stem: str
    symbols: tuple[str, ...]
    error: str = ""


def build(texts: Texts) -> ctypes.CDLL | None:
    """The library of a unit, kept or compiled; None (and one warning) where that is not possible."""
    instead = "CasADi's virtual machine is used, with the same results, some 50 times slower"
    if texts.error:
        store.warn_once(f"{texts.error}: {instead}")
        return None
    parts = [compiler.Part(name, text, _flags_of(name)) for name, text in texts.parts.items()]
    return compiler.build(parts, texts.stem, texts.symbols, instead)


def _flags_of(part: str) -> tuple[str, ...]:
    return FLAGS if part == LOOPS else SEGMENT_FLAGS if part.startswith("segment_") else KERNEL_FLAGS

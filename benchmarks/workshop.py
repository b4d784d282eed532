"""Generated C for the peers, compiled as a CasADi user would: gcc -O3 -march=native (or what stands in for gcc)."""

from __future__ import annotations

import contextlib
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from tepm_opt.errors import InputError
from tepm_opt.models.backends.compiler import find_compiler

FLAGS = ("-O3", "-march=native")


class Buffered:
    """A CasADi function called through its buffers, which saves the 30 to 40 us that converting arrays takes a plain call.

    Takes as many arguments as are given, returns the first result's nonzeros, column by column.
    """

    def __init__(self, function: ca.Function) -> None:
        self._buffer, self._run = function.buffer()
        self._arguments = [np.zeros(function.nnz_in(k)) for k in range(function.n_in())]
        self._result = np.zeros(function.nnz_out(0))
        for k, argument in enumerate(self._arguments):
            self._buffer.set_arg(k, memoryview(argument))
        self._buffer.set_res(0, memoryview(self._result))

    def __call__(self, *arguments: np.ndarray) -> np.ndarray:
        """The first result."""
        for own, argument in zip(self._arguments, arguments, strict=False):
            own[:] = argument
        self._run()
        if self._buffer.ret():
            raise RuntimeError("did not converge")
        return self._result.copy()


@dataclass(frozen=True)
class Workshop:
    """A folder and a compiler."""

    folder: Path
    compiler: tuple[str, ...]

    @staticmethod
    def at(folder: Path) -> Workshop:
        """Work in this folder with the compiler that the package uses.

        Raises:
            InputError: there is none.
        """
        compiler = find_compiler()
        if compiler is None:
            raise InputError("no C compiler: benchmarks compare generated C")
        return Workshop(folder, compiler)

    def _run(self, output: str, sources: list[Path], flags: tuple[str, ...]) -> Path:
        path = self.folder / output
        subprocess.run([*self.compiler, *flags, "-fPIC", "-o", str(path), *map(str, sources), "-lm"], check=True, capture_output=True)
        return path

    def _source(self, name: str, functions: list[ca.Function]) -> Path:
        generator = ca.CodeGenerator(f"{name}.c")
        for function in functions:
            generator.add(function)
        generator.generate(f"{self.folder}/")
        return self.folder / f"{name}.c"

    def compiled_object(self, name: str, functions: list[ca.Function]) -> Path:
        """An object file of functions, to link into several libraries."""
        return self._run(f"{name}.o", [self._source(name, functions)], (*FLAGS, "-c"))

    def link(self, name: str, parts: list[Path]) -> Path:
        """A shared library of sources and object files."""
        return self._run(f"{name}.so", parts, (*FLAGS, "-shared"))

    def external(self, function: ca.Function, objects: Path) -> ca.Function:
        """A function compiled, on top of the functions in an object file."""
        name = function.name()
        return ca.external(name, str(self.link(name, [self._source(name, [function]), objects])))

    def ipopt(self, name: str, problem: dict[str, ca.SX], options: dict[str, Any], flags: tuple[str, ...] = FLAGS) -> ca.Function:
        """IPOPT on a problem whose functions, gradient, Jacobian and exact Hessian are compiled."""
        with contextlib.chdir(self.folder):
            ca.nlpsol(name, "ipopt", problem, options).generate_dependencies(f"{name}.c")
        library = self._run(f"{name}.so", [self.folder / f"{name}.c"], (*flags, "-shared"))
        return ca.nlpsol(name, "ipopt", str(library), options)

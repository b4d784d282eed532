"""Generated C as a cache: kernels and chain.c become one shared library, kept by the hash of everything it depends on."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import threading
import warnings
from functools import cache
from importlib import resources, util
from pathlib import Path

import casadi as ca
import numpy as np
import platformdirs

from tepm_opt.data.files import atomic_path
from tepm_opt.models.chain import Solution
from tepm_opt.models.network import ROWS, Network

FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros", "-fassociative-math")
CACHE_VARIABLE = "TEPM_OPT_CACHE"


@cache
def find_compiler() -> tuple[str, ...] | None:
    """Command of a C compiler: $CC, cc, gcc, clang, or the PyPI package ziglang where that is installed; None without one."""
    for name in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        if name and (path := shutil.which(name)):
            return (path,)
    return (sys.executable, "-m", "ziglang", "cc") if util.find_spec("ziglang") else None


@cache
def _machine(compiler: tuple[str, ...]) -> str:
    version = subprocess.run([*compiler, "--version"], capture_output=True, text=True, check=False).stdout
    try:
        flags = next(line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith(("flags", "Features")))
    except (OSError, StopIteration):
        flags = platform.processor()
    return "\n".join((*compiler, version, platform.platform(), flags))


def cache_folder() -> Path:
    """Where libraries are kept: $TEPM_OPT_CACHE or the user's cache folder."""
    return Path(os.environ.get(CACHE_VARIABLE) or platformdirs.user_cache_path("tepm_opt"))


def source(network: Network) -> str:
    """The C text of a network: kernels by CasADi's code generator, sizes, chain.c."""
    generator = ca.CodeGenerator("kernels", {"casadi_int": "int", "with_header": False})
    for function in network.functions.values():
        generator.add(function)
    layout, functions = network.layout, network.functions.values()
    sizes = {
        "NB": layout.block,
        "NLEV": layout.levels,
        "NPROP": max(rows.stop for rows in network.property_rows.values()),
        "NDRIVEN": len(network.driven),
        "ROWS": ROWS,
        "NU": layout.inputs,
        "NEXT": 3 * layout.points,
        "NTHETA": len(network.parameter_names),
        "NPOINT": 3 * layout.points,
        "NLEN": layout.inputs // 2,
        "SZ_W": max(function.sz_w() for function in functions),
        "SZ_IW": max(function.sz_iw() for function in functions),
    }
    defines = "\n".join(f"#define {name} {value}" for name, value in sizes.items())
    defines += f"\nstatic const int DRIVEN[] = {{{', '.join(str(row) for row in network.driven)}}};"
    chain = (resources.files("tepm_opt.models") / "chain.c").read_text(encoding="utf-8")
    return f"{generator.dump()}\n{defines}\n{chain}"


def build(network: Network) -> Path | None:
    """The shared library of a network, from the cache or compiled; None (and one warning) where that is not possible."""
    compiler = find_compiler()
    if compiler is None:
        _warn_once("no C compiler found: CasADi's virtual machine is used, with the same results, some 50 times slower")
        return None
    text = source(network)
    key = hashlib.sha256("\n".join((text, *FLAGS, _machine(compiler))).encode()).hexdigest()[:24]
    library = cache_folder() / f"network-{key}.so"
    if library.is_file():
        return library
    try:
        library.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(library) as temporary:
            code = temporary.with_suffix(".c")
            try:
                code.write_text(text, encoding="utf-8")
                command = [*compiler, *FLAGS, "-shared", "-fPIC", "-o", str(temporary), str(code), "-lm"]
                subprocess.run(command, check=True, capture_output=True, text=True)
            finally:
                code.unlink(missing_ok=True)
    except (OSError, subprocess.CalledProcessError, ValueError) as error:
        detail = getattr(error, "stderr", None) or str(error)
        _warn_once(f"compiling the network failed, CasADi's virtual machine is used: {detail.strip().splitlines()[0]}")
        return None
    return library


@cache
def _warn_once(message: str) -> None:
    warnings.warn(message, RuntimeWarning, stacklevel=4)


class _Arrays(threading.local):
    """The arrays C reads and writes, one set a thread, so that a call costs copies and no address look-ups."""

    def __init__(self, network: Network) -> None:
        layout, parameters = network.layout, len(network.parameter_names)
        observations = 3 * layout.points + layout.inputs // 2
        shapes = {
            "x": (layout.levels + 1, layout.block),
            "u": (layout.inputs,),
            "a": (layout.inputs,),
            "external": (3 * layout.points,),
            "theta": (parameters,),
            "observed": (observations,),
            "targets": (layout.inputs // 2,),
            "info": (3,),
            "weights": (observations, observations),
            "by_u": (observations, layout.inputs),
            "by_external": (observations, 3 * layout.points),
            "by_theta": (observations, parameters),
        }
        self.array = {name: np.zeros(shape) for name, shape in shapes.items()}
        self.address = {name: array.ctypes.data for name, array in self.array.items()}


class CompiledChain:
    """Backend of compiled C (see `tepm_opt.models.chain.Chain`); thread-safe."""

    def __init__(self, network: Network, library: Path) -> None:
        self.network = network
        loaded = ctypes.CDLL(str(library))
        p, i, d = ctypes.c_void_p, ctypes.c_int, ctypes.c_double
        self._actuation, self._statics, self._sensitivity = loaded.actuation, loaded.statics, loaded.sensitivity
        self._actuation.argtypes, self._actuation.restype = [p, p, p], None
        self._statics.argtypes = [p, p, i, p, p, d, i, p, p]
        self._inverse = loaded.inverse
        self._inverse.argtypes = [p, p, p, p, p, p, d, d, d, i, p]
        self._sensitivity.argtypes = [p, p, i, p, p, i, p, p, p, p]
        self._arrays = _Arrays(network)

    def actuation(self, u: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """See `Chain.actuation`."""
        array, at = self._arrays.array, self._arrays.address
        array["u"][:], array["theta"][:] = u, theta
        self._actuation(at["u"], at["theta"], at["a"])
        return array["a"].copy()

    def statics(
        self, x: np.ndarray, u: np.ndarray, mapped: bool, external: np.ndarray, theta: np.ndarray, tolerance: float, most: int
    ) -> Solution:
        """See `Chain.statics`."""
        array, at = self._arrays.array, self._arrays.address
        array["x"][:], array["u"][:], array["external"][:], array["theta"][:] = x, u, external, theta
        status = self._statics(at["x"], at["u"], mapped, at["external"], at["theta"], tolerance, most, at["observed"], at["info"])
        return Solution(status, array["x"].copy(), array["observed"].copy(), *array["info"].tolist())

    def sensitivity(
        self, x: np.ndarray, u: np.ndarray, mapped: bool, external: np.ndarray, theta: np.ndarray, weights: np.ndarray, by_theta: bool
    ) -> tuple[int, np.ndarray, np.ndarray, np.ndarray | None]:
        """See `Chain.sensitivity`."""
        array, at, rows = self._arrays.array, self._arrays.address, len(weights)
        array["x"][:], array["u"][:], array["external"][:], array["theta"][:] = x, u, external, theta
        array["weights"][:rows] = weights
        status = self._sensitivity(
            at["x"], at["u"], mapped, at["external"], at["theta"], rows, at["weights"],
            at["by_u"], at["by_external"], at["by_theta"] if by_theta else None,
        )  # fmt: skip
        return (
            status, array["by_u"][:rows].copy(), array["by_external"][:rows].copy(), array["by_theta"][:rows].copy() if by_theta else None
        )  # fmt: skip

    def inverse(
        self, x: np.ndarray, pressures: np.ndarray, external: np.ndarray, theta: np.ndarray, weights: np.ndarray, targets: np.ndarray,
        largest: float, close: float, tolerance: float, most: int,
    ) -> tuple[int, np.ndarray, np.ndarray, int]:  # fmt: skip
        """See `Chain.inverse`."""
        array, at, half = self._arrays.array, self._arrays.address, len(targets)
        array["x"][:], array["a"][:half], array["a"][half:] = x, pressures, 0.0
        array["external"][:], array["theta"][:], array["weights"][:half], array["targets"][:] = external, theta, weights, targets
        status = self._inverse(
            at["x"], at["a"], at["external"], at["theta"], at["weights"], at["targets"], largest, close, tolerance, most, at["info"]
        )
        return status, array["x"].copy(), array["a"][:half].copy(), int(array["info"][0])

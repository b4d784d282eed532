"""A controller as a folder of C that needs neither Python nor a library."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import numpy as np

from tepm_opt.control.mpc.compiled.setup import FITS, StepSetup
from tepm_opt.data.files import atomic_path
from tepm_opt.errors import InputError
from tepm_opt.models.backends.compiled import statics_unit

CMAKE = """# cmake -B build && cmake --build build; build/example reads samples and writes commands
cmake_minimum_required(VERSION 3.10)
project(controller C)
set(CMAKE_C_STANDARD 11)
if(NOT CMAKE_BUILD_TYPE)
  set(CMAKE_BUILD_TYPE Release)
endif()
add_library(controller STATIC network.c step.c)
target_include_directories(controller PUBLIC ${CMAKE_CURRENT_SOURCE_DIR})
target_compile_options(controller PRIVATE -w -fno-math-errno)
target_link_libraries(controller PUBLIC m)
add_executable(example example.c)
target_link_libraries(example controller)
"""
FILES = ("network.c", "step.c", "data.h", "sizes.h", "controller.h", "example.c", "CMakeLists.txt")
"""Files of the folder: the network with its linearisation, the step, its data, what is declared, an example, how all is built."""


def export_step(setup: StepSetup, folder: Path) -> None:
    """Write the C of a controller, with all it needs to know of its reference.

    Args:
        setup: what the step is made of, as `Mpc.setup` has it.
        folder: that is filled, and made where it is not there.

    Raises:
        InputError: a setup for which there is no step in C, or the folder cannot be written to.
    """
    if not setup.fits:
        raise InputError(f"export: {setup}; valid: {FITS}")
    own, sizes = resources.files("tepm_opt.control.mpc.compiled"), setup.sizes
    step = (setup.source, "linearise modal;", '#include "data.h"', (own / "controller.c").read_text(encoding="utf-8"))
    texts = {
        "network.c": statics_unit(setup.model.network).source,
        "step.c": "\n".join(step),
        "data.h": _data(setup),
        "sizes.h": f"#define ACTUATORS {sizes.actuators}\n#define POINTS_TRACKED {sizes.points}\n",
        "CMakeLists.txt": CMAKE,
        **{name: (own / name).read_text(encoding="utf-8") for name in ("controller.h", "example.c")},
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name in FILES:
        with atomic_path(folder / name) as path:
            path.write_text(texts[name], encoding="utf-8")


def _data(setup: StepSetup) -> str:
    """Arrays of the reference, the network and the settings."""
    first = {"first_pressures": setup.first.pressures, "first_tensions": setup.first.tensions * setup.first.enabled}
    arrays = setup.course() | {"settings": setup.values} | first
    lines = [f"enum {{ ROWS = {len(setup.reference)}, AHEAD = {setup.ahead} }};"]
    for name, array in arrays.items():
        kind = "int" if array.dtype.kind == "i" else "double"
        lines.append(f"static const {kind} {name.upper()}[] = {{{', '.join(map(_number, array.ravel().tolist()))}}};")
    return "\n".join(lines) + "\n"


def _number(value: float) -> str:
    return repr(value) if np.isfinite(value) else "INFINITY" if value > 0 else "-INFINITY"

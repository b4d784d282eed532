"""A model, or its predictive controller, as a folder of C that needs neither Python nor a library."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np

from tepm_opt.control.mpc.compiled.export import FILES as CONTROLLER_FILES
from tepm_opt.control.mpc.compiled.export import export_step
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.control.mpc.settings import MpcSettings
from tepm_opt.control.references.reference import Reference
from tepm_opt.data.files import output_folder, write_atomically
from tepm_opt.data.setpoints import input_columns
from tepm_opt.models.backends.ccode import Unit
from tepm_opt.models.backends.compiled import STATICS, statics_unit, stepping_alone_unit
from tepm_opt.models.backends.interface import MAX_CORRECTION
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.mechanics.statics import DEFAULT

FILES = ("robot.h", "robot_sizes.h", "robot_statics.c", "robot_motion.c", "example.c", "inputs.txt", "CMakeLists.txt")
"""Files of the folder: declarations, sizes and names, the code, an example with its input, a CMake file."""
HISTORY = 64
"""Rows of inputs that a motion remembers where commands act late; else it needs the first one and the last two."""
MOTION_TOLERANCE = 1e-8
"""N: residual forces to which stages of a motion are solved."""
HEAD = """/* Written by tepm_opt from {name}: {what}. See robot.h. */
#pragma GCC diagnostic ignored "-Wunused-function" /* kernels and loops of what is not exported */
#pragma GCC diagnostic ignored "-Wunused-but-set-variable"
#pragma GCC diagnostic ignored "-Wpsabi" /* vectors never leave this file */
#define CASADI_SYMBOL_EXPORT static
#include "robot_sizes.h"
"""
USABLE = """
/* Whether inputs are within their limits, by more than rounding, and forces are numbers. */
static int usable(const double *u, const double *force) {
  static const double highest[] = ROBOT_HIGHEST;
  for (int k = 0; k < ROBOT_INPUTS; k++) if (!(u[k] >= -1e-9 * highest[k] && u[k] <= (1 + 1e-9) * highest[k])) return 0;
  for (int k = 0; k < 3 * ROBOT_POINTS; k++) if (!isfinite(force[k])) return 0;
  return 1;
}
"""


def export_c(model: CompiledModel, folder: str | Path) -> tuple[Path, ...]:
    """Write a model's statics, gain and motion in C, with header, example and CMakeLists.txt; the files written.

    Args:
        model: with its effects and parameters, which become constants.
        folder: that is filled, and made where it is not there.

    Raises:
        InputError: the folder cannot be written to.
    """
    folder, dynamics = output_folder(folder), model.reference_stepper.dynamics
    statics = replace(statics_unit(model.network), loops=STATICS)
    motion = stepping_alone_unit(dynamics)
    of_statics = {"TOLERANCE": DEFAULT.tolerance, "MOST_ITERATIONS": DEFAULT.max_iterations, "GUIDED": int(model.layout.guided)}
    of_statics["SHORTEST_LENGTH"] = DEFAULT.min_length_ratio * model.values["L_0"]
    of_motion = {"TOLERANCE": MOTION_TOLERANCE, "MAX_CORRECTION": MAX_CORRECTION}
    statics = replace(statics, sizes={**statics.sizes, **of_statics})
    motion = replace(motion, sizes={**motion.sizes, **of_motion})
    own = {name: _template(name) for name in ("robot.h", "example.c", "CMakeLists.txt")}
    texts = {
        **own,
        "robot_sizes.h": _sizes(model),
        "robot_statics.c": _unit(model, statics, "statics and gain", "statics_api.c", {"REST": model.rest}),
        "robot_motion.c": _unit(model, motion, "motion", "motion_api.c"),
        "inputs.txt": _inputs(model),
    }
    for name in FILES:
        write_atomically(folder / name, texts[name])
    return tuple(folder / name for name in FILES)


def export_controller(model: CompiledModel, reference: Reference, folder: str | Path) -> tuple[Path, ...]:
    """Write the predictive controller on a reference in C, with header, example and CMakeLists.txt; the files written.

    Args:
        model: the controller's, in C.
        reference: what is followed, see `whole_reference`.
        folder: that is filled, and made where it is not there.

    Raises:
        InputError: a model or a reference for which there is no step in C, or the folder cannot be written to.
    """
    export_step(Mpc(model, reference, MpcSettings(backend="python")).setup, output_folder(folder))
    return tuple(Path(folder) / name for name in CONTROLLER_FILES)


def _template(name: str) -> str:
    return (resources.files("tepm_opt.exports") / "c" / name).read_text(encoding="utf-8")


def _unit(model: CompiledModel, unit: Unit, what: str, api: str, arrays: Mapping[str, np.ndarray] | None = None) -> str:
    """A file of C: kernels and loops, all of them its own, and the functions of robot.h.

    Args:
        model: whose.
        unit: kernels and loops.
        what: it is for, in words.
        api: name of the file with the functions.
        arrays: of constants beside the parameters.
    """
    lines = [f"static const double {name}[] = {numbers(values.ravel())};" for name, values in (arrays or {}).items()]
    lines += [f"static const double THETA[] = {{ {_parameters(model)} }};", '#include "robot.h"', USABLE]
    return "\n".join((HEAD.format(name=_comment(model.robot.name), what=what), unit.source, *lines, _template(api)))


def _parameters(model: CompiledModel) -> str:
    return "\n  ".join(f"{number(value)}, /* {_comment(name)} */" for name, value in model.values.items())


def _sizes(model: CompiledModel) -> str:
    """robot_sizes.h: how many, in which order, within which limits."""
    layout, columns = model.layout, input_columns(model.layout.actuator_names)
    history = 3 if model.command_delay is None else HISTORY
    values = {
        "INPUTS": layout.inputs, "ACTUATORS": layout.inputs // 2, "POINTS": layout.points, "LEVELS": layout.levels + 1,
        "NODES": layout.actuators, "SHAPE": model.rest.size, "HISTORY": history,
    }  # fmt: skip
    words = {
        "INPUTS": "length of u", "ACTUATORS": "of all modules", "POINTS": ", ".join(layout.point_names), "LEVELS": "0 is the base",
        "NODES": "on a level", "SHAPE": "length of x", "HISTORY": "rows of inputs that a motion remembers",
    }  # fmt: skip
    about = [f"robot {model.robot.name}", *(f"effect {effect.label}" for effect in model.model.effects)]
    lines = [f"/* {_comment(', '.join(about))} */", "#ifndef ROBOT_SIZES_H", "#define ROBOT_SIZES_H"]
    lines += [f"#define ROBOT_{name} {value} /* {words[name]} */" for name, value in values.items()]
    lines += [f"#define ROBOT_LOWEST {numbers(0 * model.input_max)}", f"#define ROBOT_HIGHEST {numbers(model.input_max)}"]
    lines += ["/* u: " + ", ".join(f"{k} {name}" for k, name in enumerate(columns)), "   lengths: " + ", ".join(layout.actuator_names)]
    return "\n".join([*lines, "   forces, points: x, y, z of each */", "#endif", ""])


def _inputs(model: CompiledModel) -> str:
    """Rows for the example: rest, then the first module's pressures and tensions rising."""
    layout = model.layout
    rows, first = np.zeros((6, 1 + layout.inputs + 3 * layout.points)), 1 + layout.inputs // 2
    rows[:, 0] = 0.1 * np.arange(len(rows))
    rows[:, 1] = np.linspace(0, 0.2, len(rows)) * model.input_max[0]
    rows[:, first] = np.linspace(0, 0.1, len(rows)) * model.input_max[layout.inputs // 2]
    return "".join(" ".join(map(number, row)) + "\n" for row in rows.tolist())


def numbers(values: Iterable[float]) -> str:
    """Numbers as C initialises an array with them."""
    return f"{{{', '.join(number(float(value)) for value in values)}}}"


def number(value: float) -> str:
    """A number in C that reads back equal."""
    return repr(value) if np.isfinite(value) else "INFINITY" if value > 0 else "-INFINITY"


def _comment(text: str) -> str:
    """Text that cannot end a comment."""
    return text.replace("*/", "* /").replace("/*", "/ *").replace("\n", " ")

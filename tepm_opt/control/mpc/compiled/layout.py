"""Layout of the data that the C of a step takes: sizes as macros, settings and results as structures of doubles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources

import casadi as ca
import numpy as np

from tepm_opt.control.actuation.delay_line import MOST_LATE
from tepm_opt.control.diagnostics.sensors import EVERY, WINDOW
from tepm_opt.models.backends.ccode import Unit
from tepm_opt.models.backends.interface import GUARDS, MODES, SHARED
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.linear.modal_model import SWEEPS

FILES = ("state.c", "points.c", "devices.c", "filter.c", "horizon.c", "program.c", "command.c")
SYMBOLS = ("step_size", "step_outcome", "step_open", "step_prepare", "step_feedback", "step_point", "step_distrust_monitors")
ITERATIONS = 1000  # changes of the active set


@dataclass(frozen=True)
class Sizes:
    """Sizes of a step.

    Attributes:
        actuators, points: of the robot.
        levels, free: coordinates of all levels and of the free ones.
        stages, preview, window: of the horizon, of the pressures' preview and of its slope.
        ahead: periods from a sample to when a command acts, as declared.
        memory: internal states of the model's effects on inputs.
    """

    actuators: int
    points: int
    levels: int
    free: int
    stages: int
    preview: int
    window: int
    ahead: int
    memory: int

    @staticmethod
    def from_model(model: CompiledModel, stages: int, preview: int, window: int, ahead: int, memory: int) -> Sizes:
        """Sizes for a model.

        Args:
            model: compiled.
            stages: of the horizon.
            preview: stages for which the need of pressure is known ahead.
            window: stages over which its slope is taken.
            ahead: periods from a sample to when a command acts.
            memory: internal states of its effects on inputs.
        """
        layout, free = model.layout, model.layout.levels * model.layout.block
        return Sizes(layout.inputs // 2, layout.points, free + layout.block, free, stages, preview, window, ahead, memory)

    @property
    def modes(self) -> int:
        """Modes that count."""
        return min(MODES, self.free)

    @property
    def shapes(self) -> int:
        """Shapes that are carried along."""
        return min(MODES + GUARDS, self.free)

    @property
    def state(self) -> int:
        """Length of the filter's state."""
        return 2 * self.modes + 4 * self.actuators + 3 * self.points

    @property
    def results(self) -> dict[str, int]:
        """Lengths of what a step leaves, in the order of the structure `outcome`."""
        each = ("pressures", "tensions", "against", "direction", "turning", "deviation", "pressure_offset", "tension_offset")
        each += ("lasting_pressure", "lasting_tension", "monitor_noise")
        single = (
            "row",
            "status",
            "iterations",
            "moves",
            "nis",
            "seen",
            "late",
            "ahead",
            "noise",
            "doubtful",
            "seconds",
            "refusals",
            "common",
        )
        sizes = dict.fromkeys(each, self.actuators) | dict.fromkeys(single, 1)
        more = {
            "quicker": 2 * self.actuators,
            "state": self.state,
            "points": 3 * self.points,
            "refused": self.points,
            "plan": self.stages * self.actuators,
        }
        return sizes | more

    def source(self, settings: Mapping[str, float | np.ndarray], input_motion: ca.Function | None) -> str:
        """The C text.

        Args:
            settings: whose names count; their values are told later.
            input_motion: the model's function of that name (see `models.dynamics`); None without effects on inputs.
        """
        macros = {
            "NA": self.actuators, "NP": self.points, "NQ": self.modes, "NSHAPE": self.shapes, "NCO": self.free, "NLEVELS": self.levels,
            "STAGES": self.stages, "PREVIEW": self.preview, "WINDOW": self.window, "KEPT": count_kept_points(self.ahead),
            "SWEEPS": SWEEPS, "NOISE_WINDOW": WINDOW, "NOISE_EVERY": EVERY, "MOST_LATE": MOST_LATE, "MOST_ITERATIONS": ITERATIONS,
            "MEMORY": self.memory, "EFFECTS": int(input_motion is not None),
        }  # fmt: skip
        lines = [] if input_motion is None else [Unit({"input_motion": input_motion}, {"LANES": SHARED["LANES"]}, {}, {}, (), ()).source]
        lines += [f"#define {name} {value}" for name, value in macros.items()]
        lines += [_structure("settings", {name: np.size(value) for name, value in settings.items()})]
        lines += [_structure("outcome", self.results)]
        folder = resources.files("tepm_opt.control.mpc.compiled")
        return "\n".join((*lines, *((folder / name).read_text(encoding="utf-8") for name in FILES)))


def count_kept_points(ahead: int) -> int:
    """Number of operating points to keep: more than lie between an estimate and the point `ahead` periods or more later."""
    return 16 * -(-(ahead + MOST_LATE + 4) // 16)


def _structure(name: str, sizes: Mapping[str, int]) -> str:
    """A structure of doubles; settings of one value are plain numbers, all results are arrays."""
    plain = name == "settings"
    fields = (f"{field}{'' if plain and size == 1 else f'[{size}]'}" for field, size in sizes.items())
    return f"typedef struct {{ double {', '.join(fields)}; }} {name};"

"""Small motions about an operating point: modes, state space, a reduced system."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import savemat

from tepm_opt.data.files import atomic_path, output_folder
from tepm_opt.data.frames import Tabular
from tepm_opt.data.setpoints import point_columns
from tepm_opt.data.tables import write_columns
from tepm_opt.jobs.output import save_summary
from tepm_opt.models.compile import CompiledModel
from tepm_opt.outcome import Outcome
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.linear.modes import Mode, modes
from tepm_opt.solvers.linear.reduction import Reduced, balanced_reduction
from tepm_opt.solvers.linear.state_space import Linear, linearise
from tepm_opt.solvers.mechanics.statics import Equilibrium
from tepm_opt.solvers.mechanics.step_limit import stable_step

MOVED = 5e-5  # m at the tip by an input's whole range: less does not count as driven
TOLERANCE = 1e-3  # m per range: bound of the reduced system where no order is given
MAT_HEADER = b"MATLAB 5.0 MAT-file, state space of tepm robot modes".ljust(116)  # instead of one with the time of writing
SHOWN = 12


@dataclass(frozen=True, eq=False)
class ModesRun(Tabular):
    """Small motions about an operating point.

    Attributes:
        linear: the linearised system.
        modes: slowest first.
        step: largest stable step of RK4 in s.
        reduced: a smaller system of the chosen inputs and outputs.
    """

    linear: Linear
    modes: tuple[Mode, ...]
    step: float
    reduced: Reduced

    def __repr__(self) -> str:
        return f"<ModesRun {self.outcome}; {len(self.modes)} modes of {len(self.linear.A)} states of {self.model.robot.name}>"

    @property
    def model(self) -> CompiledModel:
        """The model that was linearised."""
        return self.linear.equilibrium.model

    @property
    def outcome(self) -> Outcome:
        """Outcome, always solved: a stable operating point has modes."""
        return Outcome()

    @property
    def ok(self) -> bool:
        """Whether it came to its end."""
        return self.outcome.solved

    def driver(self, mode: Mode) -> tuple[str, float]:
        """The pressure or tension that moves the tip most by this mode, and how far by its whole range, at rest, in m."""
        layout = self.model.layout
        tip = slice(3 * layout.points - 3, 3 * layout.points)
        moved = np.linalg.norm((mode.steady * self.linear.ranges)[tip, : layout.inputs], axis=0)
        at = int(np.argmax(moved.round(9)))
        return (self.linear.inputs[at], float(moved[at])) if moved[at] > MOVED else ("none", float(moved[at]))

    def summary(self, shown: int = SHOWN) -> dict[str, Any]:
        """Numbers of the operating point and of its slowest modes, `shown` of them."""
        at = self.linear.equilibrium
        slowest = [
            {
                "frequency_Hz": mode.frequency, "damping": mode.damping, "time_constant_s": mode.time_constant,
                "together": mode.multiplicity,
                "shape": mode.words, "driven_most_by": self.driver(mode)[0],
            }
            for mode in self.modes[:shown]
        ]  # fmt: skip
        reduced = {
            "inputs": list(self.reduced.inputs), "outputs": list(self.reduced.outputs), "order": len(self.reduced.A),
            "error_bound_m_per_range": self.reduced.bound,
        }  # fmt: skip
        return {
            "robot": at.model.robot.name,
            "inputs": at.inputs.tolist(),
            "tip_force_N": at.loads[-1].tolist(),
            "tip_m": at.tip.tolist(),
            "states": len(self.linear.A),
            "states_with_eigenvalue_0": int(self.linear.held.sum()),
            "delay_s": self.linear.delay,
            "fastest_eigenvalue_1_per_s": max(abs(mode.value) for mode in self.modes),
            "largest_rk4_step_s": self.step,
            "modes": slowest,
            "reduced": reduced,
        }

    def save(self, folder: str | Path, shown: int = SHOWN) -> None:
        """Write modes.csv, state_space.mat and summary.json.

        state_space.mat (MATLAB 5: MATLAB's `load`, SciPy's `loadmat`) holds A, B, C, D in SI without held states, input_names,
        output_names, state_names, input_ranges, delay_s, and the operating point in inputs and outputs.

        Raises:
            InputError: the folder cannot be written to.
        """
        folder = output_folder(folder)
        write_columns(folder / "modes.csv", self.columns())
        moving, at = self.linear.without_held_states(), self.linear.equilibrium
        content = {
            "A": moving.A, "B": moving.B, "C": moving.C, "D": moving.D,
            "input_names": np.array(moving.inputs, dtype=object), "output_names": np.array(moving.outputs, dtype=object),
            "state_names": np.array(moving.state_names, dtype=object),
            "input_ranges": moving.ranges, "delay_s": moving.delay, "inputs": np.append(at.inputs, at.loads.ravel()),
            "outputs": np.append(at.points.ravel(), at.lengths.ravel()),
        }  # fmt: skip
        buffer = BytesIO()
        savemat(buffer, content, oned_as="column")
        with atomic_path(folder / "state_space.mat") as temporary:
            temporary.write_bytes(MAT_HEADER + buffer.getvalue()[len(MAT_HEADER) :])
        save_summary(folder, "modes", self.summary(shown))

    def columns(self) -> dict[str, np.ndarray]:
        """The modes, a row each, slowest first."""
        found = self.modes
        drivers = [self.driver(mode) for mode in found]
        numbers = {
            "frequency_Hz": [mode.frequency for mode in found],
            "damping": [mode.damping for mode in found],
            "time_constant_s": [mode.time_constant for mode in found],
            "real_1_per_s": [mode.value.real for mode in found],
            "imaginary_rad_per_s": [mode.value.imag for mode in found],
            "together": [mode.multiplicity for mode in found],
        }
        words = {"shape": [mode.words for mode in found], "driven_most_by": [name for name, _ in drivers]}
        names = point_columns(self.model.layout.point_names)
        shapes = np.array([mode.points.ravel() for mode in found]).T
        return {
            **{name: np.array(values, dtype=float) for name, values in numbers.items()},
            **{name: np.array(values, dtype=np.str_) for name, values in words.items()},
            "driven_tip_m": np.array([moved for _, moved in drivers]),
            **{name.removesuffix("_m"): row for name, row in zip(names, shapes, strict=True)},
        }


def run_modes(
    equilibrium: Equilibrium,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    order: int | None = None,
    progress: Progress = silent,
) -> ModesRun:
    """Find the modes about an operating point, and a reduced system of some inputs and outputs.

    Args:
        equilibrium: the operating point, solved.
        inputs: of the reduced system, such as "pressure_11" or "force_s4_x"; pressure and tension of the first actuator where absent.
        outputs: of the reduced system, such as "s4", "s2_x" or "length_11"; the tip where absent.
        order: states of the reduced system; as many as 1 mm per range takes where absent.
        progress: told what is being done.

    Raises:
        InputError: no such input, output or order.
    """
    layout = equilibrium.model.layout
    inputs = inputs or [f"{kind}_{layout.actuator_names[0]}" for kind in ("pressure", "tension")]
    outputs = outputs or [layout.point_names[-1]]
    progress("linearising", 0, 0)
    linear = linearise(equilibrium)
    progress("reducing", 0, 0)
    reduced = balanced_reduction(linear, order, tolerance=None if order else TOLERANCE, inputs=inputs, outputs=outputs)
    progress("modes", 0, 0)
    return ModesRun(linear, modes(linear), stable_step(equilibrium), reduced)

"""`tepm modes`: small motions about an operating point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.markup import escape
from scipy.io import savemat

from tepm_opt import plots
from tepm_opt.cli.common import UNSOLVED, JsonOption, ModelOption, RobotOption, load, report, stderr, vector
from tepm_opt.data.files import atomic_path, output_folder
from tepm_opt.data.setpoints import point_columns, read_setpoints
from tepm_opt.data.tables import write_columns
from tepm_opt.errors import InputError
from tepm_opt.jobs.runs import save_summary
from tepm_opt.models.compile import CompiledModel
from tepm_opt.plots import linear as linear_plots
from tepm_opt.solvers.linear import Linear, linearise
from tepm_opt.solvers.modes import Mode, modes
from tepm_opt.solvers.reduction import Reduced, balanced
from tepm_opt.solvers.simulate import stable_step
from tepm_opt.solvers.statics import Equilibrium, solve_statics

MOVED = 5e-5  # m at the tip by an input's whole range: less does not count as driven
TOLERANCE = 1e-3  # m per range: bound of the reduced system where no order is given
MAT_HEADER = b"MATLAB 5.0 MAT-file, state space of tepm modes".ljust(116)  # instead of one with the time of writing


@dataclass(frozen=True, eq=False)
class Analysis:
    """What is known about an operating point.

    Attributes:
        linear: its system.
        modes: slowest first.
        step: largest stable step of RK4 in s.
        reduced: of the chosen inputs and outputs.
    """

    linear: Linear
    modes: tuple[Mode, ...]
    step: float
    reduced: Reduced

    def driver(self, mode: Mode) -> tuple[str, float]:
        """The pressure or tension that moves the tip most by this mode, and how far by its whole range, at rest, in m."""
        layout = self.linear.equilibrium.model.layout
        tip = slice(3 * layout.points - 3, 3 * layout.points)
        moved = np.linalg.norm((mode.steady * self.linear.ranges)[tip, : layout.inputs], axis=0)
        at = int(np.argmax(moved.round(9)))
        return (self.linear.inputs[at], float(moved[at])) if moved[at] > MOVED else ("none", float(moved[at]))

    def summary(self, shown: int) -> dict[str, Any]:
        """Numbers of the operating point and of its slowest modes."""
        at = self.linear.equilibrium
        slowest = [
            {
                "frequency_Hz": mode.frequency, "damping": mode.damping, "time_constant_s": mode.time_constant, "together": mode.together,
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

    def save(self, folder: Path, shown: int) -> None:
        """Write modes.csv, state_space.mat and summary.json.

        state_space.mat (MATLAB 5: MATLAB's `load`, SciPy's `loadmat`) holds A, B, C, D in SI without held states, input_names,
        output_names, input_ranges, delay_s, and the operating point in inputs and outputs.

        Raises:
            InputError: the folder cannot be written to.
        """
        write_columns(folder / "modes.csv", self._table())
        moving, at = self.linear.moving(), self.linear.equilibrium
        content = {name: getattr(moving, name) for name in "ABCD"} | {
            "input_names": np.array(moving.inputs, dtype=object), "output_names": np.array(moving.outputs, dtype=object),
            "input_ranges": moving.ranges, "delay_s": moving.delay, "inputs": np.append(at.inputs, at.loads.ravel()),
            "outputs": np.append(at.points.ravel(), at.lengths.ravel()),
        }  # fmt: skip
        buffer = BytesIO()
        savemat(buffer, content, oned_as="column")
        with atomic_path(folder / "state_space.mat") as temporary:
            temporary.write_bytes(MAT_HEADER + buffer.getvalue()[len(MAT_HEADER) :])
        save_summary(folder, "modes", self.summary(shown))

    def _table(self) -> dict[str, np.ndarray]:
        found = self.modes
        drivers = [self.driver(mode) for mode in found]
        numbers = {
            "frequency_Hz": [mode.frequency for mode in found],
            "damping": [mode.damping for mode in found],
            "time_constant_s": [mode.time_constant for mode in found],
            "real_1_per_s": [mode.value.real for mode in found],
            "imaginary_rad_per_s": [mode.value.imag for mode in found],
            "together": [mode.together for mode in found],
        }
        words = {"shape": [mode.words for mode in found], "driven_most_by": [name for name, _ in drivers]}
        names = point_columns(self.linear.equilibrium.model.layout.point_names)
        shapes = np.array([mode.points.ravel() for mode in found]).T
        return {
            **{name: np.array(values, dtype=float) for name, values in numbers.items()},
            **{name: np.array(values, dtype=np.str_) for name, values in words.items()},
            "driven_tip_m": np.array([moved for _, moved in drivers]),
            **{name.removesuffix("_m"): row for name, row in zip(names, shapes, strict=True)},
        }

    def lines(self, shown: int, out: Path | None) -> list[str]:
        """What people read."""
        at, held = self.linear.equilibrium, int(self.linear.held.sum())
        tip = ", ".join(f"{1e3 * value + 0.0:.1f}" for value in at.tip.round(9))
        where = f", files in {escape(str(out))}" if out else ""
        text = [f"[bold]{len(self.modes)} modes[/] of {len(self.linear.A)} states about tip ({tip}) mm{where}"]
        if held:
            text.append(
                f"{held} eigenvalues are 0: internal states that stick (dry friction, hysteresis) and act as springs on small motions"
            )
        text += ["", "frequency  damping   time const.  tip by full range     shape"]
        text += _merged([(mode, self._line(mode)) for mode in self.modes])[:shown]
        text += [
            "",
            f"fastest eigenvalue {max(abs(mode.value) for mode in self.modes):.4g} 1/s; RK4 is stable up to {1e3 * self.step:.4f} ms",
        ]
        if self.linear.delay:
            text.append(f"pressures and tensions act {1e3 * self.linear.delay:g} ms late")
        bound = f"within {1e3 * self.reduced.bound:.2g} mm per full range at any frequency"
        text.append(f"{' and '.join(self.reduced.inputs)} to {', '.join(self.reduced.outputs)}: {len(self.reduced.A)} states do, {bound}")
        return text

    def _line(self, mode: Mode) -> str:
        name, moved = self.driver(mode)
        swings = f"{mode.frequency:6.2f} Hz  {mode.damping:7.4f}" if mode.oscillates else f"{'-':>9}  {'-':>7}"
        driven = f"{1e3 * moved:6.1f} mm {name:12}" if name != "none" else f"{'-':>9} {'':12}"
        return f"{swings}  {mode.time_constant:10.4g} s  {driven}{mode.words}"


def _merged(rows: Sequence[tuple[Mode, str]]) -> list[str]:
    """Lines of the table, more than two modes of memory in a row being one."""
    text: list[str] = []
    k = 0
    while k < len(rows):
        end = k
        while rows[k][0].memory and end < len(rows) and rows[end][0].memory == rows[k][0].memory:
            end += 1
        if end - k > 2:
            times = [mode.time_constant for mode, _ in rows[k:end]]
            text.append(f"{'-':>9}  {'-':>7}  {min(times):.3g} … {max(times):.3g} s: {end - k} modes, {rows[k][0].memory}")
            k = end
        else:
            text.append(rows[k][1])
            k += 1
    return text


def analyse(equilibrium: Equilibrium, inputs: Sequence[str], outputs: Sequence[str], order: int | None) -> Analysis:
    """Modes and a reduced system of the chosen inputs and outputs.

    Raises:
        InputError: no such input, output or order.
    """
    linear = linearise(equilibrium)
    reduced = balanced(linear, order, tolerance=None if order else TOLERANCE, inputs=inputs, outputs=outputs)
    return Analysis(linear, modes(linear), stable_step(equilibrium), reduced)


def draw(analysis: Analysis, folder: Path) -> None:
    """Figures of modes, Bode diagram and step response."""
    at = analysis.linear.equilibrium
    title = f"{at.model.robot.name} about tip ({', '.join(f'{1e3 * value + 0.0:.0f}' for value in at.tip.round(6))}) mm"
    plots.save(linear_plots.shapes_figure(analysis.modes, title), folder / "modes.png")
    system = analysis.linear.select(analysis.reduced.inputs, analysis.reduced.outputs)
    duration = 4 * max([mode.time_constant for mode in analysis.modes if mode.oscillates] or [analysis.modes[0].time_constant])
    plots.save(linear_plots.bode_figure(system, title), folder / "bode.png")
    plots.save(linear_plots.step_figure(system, analysis.reduced, duration, title), folder / "step.png")


def _operating_point(
    model: CompiledModel, inputs: Path | None, row: int | None, pressures: str | None, tensions: str | None, tip_force: str | None
) -> Equilibrium:
    layout = model.layout
    if inputs is None:
        if row is not None:
            raise InputError(f"--row {row} needs a set-point file")
        half = layout.inputs // 2
        given = [vector(text, name, half) or [0.0] * half for text, name in ((pressures, "--pressures"), (tensions, "--tensions"))]
        return solve_statics(model, np.concatenate(given), vector(tip_force, "--tip-force"))
    if pressures or tensions or tip_force:
        raise InputError("a set-point file and --pressures, --tensions or --tip-force exclude each other")
    setpoints = read_setpoints(inputs, layout.actuator_names, model.input_max)
    row = 1 if row is None else row
    if not 1 <= row <= len(setpoints.time):
        raise InputError(f"--row {row}: {inputs} has no such row; valid: 1 … {len(setpoints.time)}")
    if not np.isfinite(setpoints.inputs[row - 1]).all():
        raise InputError(f"--row {row}: {inputs} has no inputs there; valid: a row with inputs")
    return solve_statics(model, setpoints.inputs[row - 1], setpoints.tip_force[row - 1])


def modes_command(
    inputs: Annotated[Path | None, typer.Argument(help="Set-point file; one of its rows is the operating point.")] = None,
    row: Annotated[int | None, typer.Option("--row", help="Which row of the file, from 1; the first where absent.")] = None,
    pressures: Annotated[str | None, typer.Option("--pressures", help="Instead of a file: all pressures in Pa, by commas.")] = None,
    tensions: Annotated[str | None, typer.Option("--tensions", help="Instead of a file: all tensions in N, by commas.")] = None,
    tip_force: Annotated[str | None, typer.Option("--tip-force", help="Instead of a file: force on the tip in G, x,y,z in N.")] = None,
    start: Annotated[str | None, typer.Option("--from", help="Inputs for Bode and step, by commas: pressure_11, force_s4_x …")] = None,
    end: Annotated[
        str | None, typer.Option("--to", help="Outputs for Bode and step, by commas: s4, s2_x, length_11 …; else the tip.")
    ] = None,
    order: Annotated[
        int | None, typer.Option("--order", help="States of the reduced system; else as many as 1 mm per range takes.")
    ] = None,
    count: Annotated[int, typer.Option("--count", help="How many modes to print.")] = 12,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the results; none are written without it.")] = None,
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """Small motions about an operating point: modes, state space, Bode diagram, step response, a reduced system."""
    for name, value in (("--count", count), ("--order", order)):
        if value is not None and value < 1:
            raise InputError(f"{name} {value}; valid: at least 1")
    compiled = load(robot, model)
    layout = compiled.layout
    chosen = (
        [name.strip() for name in start.split(",")] if start else [f"{kind}_{layout.actuator_names[0]}" for kind in ("pressure", "tension")]
    )
    seen = [name.strip() for name in end.split(",")] if end else [layout.point_names[-1]]
    equilibrium = _operating_point(compiled, inputs, row, pressures, tensions, tip_force)
    if not equilibrium.solved:
        stderr.print(f"[yellow]no stable operating point: {escape(equilibrium.outcome.message)}[/]", soft_wrap=True, highlight=False)
        return UNSOLVED
    analysis = analyse(equilibrium, chosen, seen, order)
    if out is not None:
        folder = output_folder(out)
        analysis.save(folder, count)
        draw(analysis, folder)
    return report(analysis.summary(count), analysis.lines(count, out), as_json, True)

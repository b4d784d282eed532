"""The open-loop gain matrix along set points, the paper's curves, and a map of the workspace."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.files import output_folder
from tepm_opt.data.frames import Tabular
from tepm_opt.data.setpoints import SetPoints, gain_columns
from tepm_opt.data.tables import write_columns, write_table
from tepm_opt.jobs.output import outcome_of, save_summary
from tepm_opt.jobs.statics import StaticsRun, run_statics
from tepm_opt.models.compile import CompiledModel
from tepm_opt.outcome import Outcome
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.linear.gain import Actuation, Curve, Gain, WorkspaceMap, input_curve, solve_gain, workspace_map

INTERVALS = {"10–20 %": (0.10, 0.20), "45–55 %": (0.45, 0.55)}
MAP = "gain_map.csv"


def _mm(metres: Iterable[float]) -> list[float]:
    return [round(1e3 * float(value), 6) for value in metres]


def _measures(gain: Gain, kind: Actuation) -> dict[str, Any]:
    """Singular values in mm, condition (null where a direction cannot be driven) and manipulability of one actuation."""
    condition = gain.condition(kind)
    return {
        "singular_values_mm": _mm(gain.singular_values(kind)),
        "condition": condition if np.isfinite(condition) else None,
        "manipulability_m3": gain.manipulability(kind),
    }


@dataclass(frozen=True, eq=False)
class GainRun(Tabular):
    """G of a reference point under set points.

    Attributes:
        statics: the operating points.
        gains: one a row; None where the operating point is not stable.
        workspace: G over the workspace; None where it was not asked for.
    """

    statics: StaticsRun
    gains: list[Gain | None]
    workspace: WorkspaceMap | None = None

    def __repr__(self) -> str:
        return f"<GainRun {self.outcome}; {len(self.statics.setpoints.time)} rows of {self.model.robot.name}>"

    @property
    def model(self) -> CompiledModel:
        """The model whose gain it is."""
        return self.statics.model

    @property
    def outcome(self) -> Outcome:
        """Outcome: solved where G is known at every row."""
        found = sum(gain is not None for gain in self.gains)
        return outcome_of(found, len(self.statics.setpoints.time), self.statics.interrupted)

    @property
    def ok(self) -> bool:
        """Whether G was found at every row."""
        return self.outcome.solved

    @cached_property
    def curves(self) -> dict[tuple[str, str], Curve]:
        """Fig. 11's curves of the third actuator by actuation and interval; those with an unstable operating point are left out."""
        found = {}
        for label, (low, high) in INTERVALS.items():
            for kind in ("pressure", "tension"):
                try:
                    found[kind, label] = input_curve(self.model, kind, self.model.layout.actuator_names[2], low, high)
                except ValueError:
                    continue
        return found

    def spans(self) -> dict[Actuation, tuple[float, float]]:
        """Smallest and largest singular value of all rows in m per full range, of pressure and of tension; empty where G is unknown."""
        found = [gain for gain in self.gains if gain]
        kinds: tuple[Actuation, ...] = ("pressure", "tension")
        values: dict[Actuation, np.ndarray] = {kind: np.array([gain.singular_values(kind) for gain in found]) for kind in kinds if found}
        return {kind: (float(of_kind.min()), float(of_kind.max())) for kind, of_kind in values.items()}

    def summary(self) -> dict[str, Any]:
        """Numbers of the run: `spans`, and per row the singular values in mm, condition and manipulability in m³ of each actuation."""
        kinds: tuple[Actuation, ...] = ("both", "pressure", "tension")
        rows = [gain and {kind: _measures(gain, kind) for kind in kinds} for gain in self.gains]
        summary = self.statics.summary()
        names = ("robot", "points", "solved", "interrupted", "unsolved")
        point = next((gain.point for gain in self.gains if gain), -1)
        label = self.statics.model.layout.point_names[point]
        spans = {kind: list(span) for kind, span in self.spans().items()}
        return {
            **{name: summary[name] for name in names},
            "reference_point": label,
            "singular_values_m_per_range": spans,
            "normalised": rows,
        }

    def columns(self) -> dict[str, np.ndarray]:
        """The operating points as `StaticsRun` has them, with G in SI, row by row; NaN where there is none."""
        names = gain_columns(self.model.layout.inputs)
        empty = np.full(len(names), np.nan)
        rows = np.array([empty if gain is None else gain.matrix.ravel() for gain in self.gains]).reshape(-1, len(names))
        return self.statics.columns() | dict(zip(names, rows.T, strict=True))

    def save(self, folder: str | Path) -> None:
        """Write gain.csv (G in SI, row by row, one line an operating point), summary.json and, where there is a map, gain_map.csv.

        Raises:
            InputError: the folder cannot be written to.
        """
        if not self.gains:
            return
        folder, columns = output_folder(folder), self.columns()
        write_columns(folder / "gain.csv", {name: columns[name] for name in gain_columns(self.model.layout.inputs)})
        save_summary(folder, "gain", self.summary())
        if self.workspace is not None:
            _save_map(self.workspace, folder / MAP)


def run_gain(
    model: CompiledModel, setpoints: SetPoints, point: int = -1, with_map: bool = False, progress: Progress = silent,
    executor: Executor | None = None,
) -> GainRun:  # fmt: skip
    """Compute G of a reference point at every row of set points.

    Args:
        model: compiled model.
        setpoints: operating points.
        point: number of the reference point; the tip where absent.
        with_map: whether to map G over the workspace too.
        progress: told of every row, of the map, too.
        executor: where the map's rows are computed; here, one after the other, where None.

    Raises:
        InputError: inputs outside the robot's limits.
    """
    statics = run_statics(model, setpoints, progress)
    gains = [solve_gain(at, point) if at.solved else None for at in statics.equilibria]
    return GainRun(statics, gains, _workspace(model, progress, executor) if with_map and not statics.interrupted else None)


def _workspace(model: CompiledModel, progress: Progress, executor: Executor | None) -> WorkspaceMap:
    """G over a vertical plane that holds the robot's workspace; a coarser grid where no C compiler makes it quick."""
    count = 17 if model.is_c else 9
    height = model.layout.modules * model.values["L_0"]
    across, up = np.linspace(-0.96, 0.96, count) * height, np.linspace(0.1, 1.3, count) * height
    return workspace_map(model, across, up, progress=progress, executor=executor)


def _save_map(workspace: WorkspaceMap, path: Path) -> None:
    """Write the map: tip position and, where in reach, singular values of pressure and tension."""
    rows = []
    for z, gains in zip(workspace.height, workspace.gains, strict=True):
        for x, gain in zip(workspace.across, gains, strict=True):
            values = [np.full(3, np.nan)] * 2 if gain is None else [gain.singular_values("pressure"), gain.singular_values("tension")]
            rows.append([x, z, *np.concatenate(values)])
    names = ["across_m", "z_m", *(f"{kind}_sigma_{k}_m" for kind in ("pressure", "tension") for k in (1, 2, 3))]
    write_table(path, names, np.array(rows))

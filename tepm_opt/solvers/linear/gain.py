"""The open-loop gain matrix G of Eq. (6): how a reference point moves with every pressure and tension."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Literal

import numpy as np

from tepm_opt.errors import unknown_name
from tepm_opt.models.backends.interface import Status
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.layout import Layout
from tepm_opt.progress import Progress, silent, track
from tepm_opt.renamed import RenamedMethod
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.kinematics.ik import Configuration, each_configuration
from tepm_opt.solvers.mechanics.statics import Equilibrium, solve_statics
from tepm_opt.solvers.numerics.parallel import each_done
from tepm_opt.solvers.numerics.text import html_table

Actuation = Literal["pressure", "tension", "both"]


@dataclass(frozen=True, eq=False)
class Gain:
    """G at an operating point.

    Attributes:
        matrix: d(point)/du, (3, 2 · modules · actuators) in m/Pa and m/N.
        by_load: d(point)/d(force on a reference point), the compliance, (3, points, 3) in m/N.
        by_parameter: d(point)/d(parameter), (3, parameters) in m per the parameter's unit, in `network.parameter_names`' order.
        equilibrium: the operating point.
        point: index of the reference point; the last is the tip.
    """

    matrix: np.ndarray
    by_load: np.ndarray
    by_parameter: np.ndarray | None
    equilibrium: Equilibrium
    point: int

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        name = self.equilibrium.model.layout.point_names[self.point]
        parts = [f"{kind} {_singular(self, kind)}" for kind in ("pressure", "tension")]
        return f"Gain({name}, singular values over the full range: {', '.join(parts)} mm)"

    def _repr_html_(self) -> str:
        """Singular values, condition and manipulability of each actuation, as a table."""
        rows = [
            (kind, _singular(self, kind), f"{self.condition(kind):.3g}", f"{1e9 * self.manipulability(kind):.3g}")
            for kind in ("pressure", "tension", "both")
        ]
        return html_table(("inputs", "singular values in mm", "condition", "manipulability in mm³"), rows)

    def normalise(self, actuation: Actuation = "both") -> np.ndarray:
        """Scale columns by their input's range (Fig. 11's dimensionless inputs), in m; all columns or one actuation's."""
        scaled = self.matrix * self.equilibrium.model.input_max
        half = scaled.shape[1] // 2
        return {"pressure": scaled[:, :half], "tension": scaled[:, half:], "both": scaled}[actuation]

    normalised = RenamedMethod("normalise")

    def singular_values(self, actuation: Actuation = "both") -> np.ndarray:
        """Singular values (3,) of the normalised gain in m, largest first."""
        return np.linalg.svd(self.normalise(actuation), compute_uv=False)

    def condition(self, actuation: Actuation = "both") -> float:
        """Largest over smallest singular value; infinite where a direction cannot be driven."""
        values = self.singular_values(actuation)
        return float(values[0] / values[-1]) if values[-1] > 1e-12 * values[0] else np.inf

    def manipulability(self, actuation: Actuation = "both") -> float:
        """Product of the singular values in m³ (Yoshikawa, IJRR 4, 1985): 0 where a direction cannot be driven."""
        return float(np.prod(self.singular_values(actuation)))


def _singular(gain: Gain, kind: Actuation) -> str:
    return " / ".join(f"{1e3 * value:.3g}" for value in gain.singular_values(kind))


@lru_cache(maxsize=64)
def _coordinates(layout: Layout, point: int) -> np.ndarray:
    """Rows that pick a point's coordinates from the observations (points in G, then lengths)."""
    rows = np.zeros((3, 3 * layout.points + layout.inputs // 2))
    rows[:, 3 * point : 3 * point + 3] = np.eye(3)
    return rows


def solve_gain(equilibrium: Equilibrium, point: int = -1, parameters: bool = False) -> Gain:
    """G at a stable equilibrium by the implicit function theorem: three adjoint solves with the factor of the stiffness.

    Args:
        equilibrium: a stable one.
        point: index of the reference point; the tip where absent.
        parameters: whether to differentiate by the model's parameters, too.

    Raises:
        ValueError: the equilibrium is not stable (its displacements have no derivative worth the name), or no such point.
    """
    model, points = equilibrium.model, equilibrium.model.layout.points
    if not -points <= point < points:
        raise ValueError(f"point {point}; valid: 0 … {points - 1}")
    if not equilibrium.solved:
        raise ValueError(f"no gain at this operating point: {equilibrium.outcome.message}")
    point %= points
    status, by_u, by_load, by_theta = model.statics.sensitivity(
        equilibrium.x, equilibrium.load_case, _coordinates(model.layout, point), parameters
    )
    if status != Status.SOLVED:
        raise ValueError("no gain at this operating point: its stiffness is not positive definite")
    return Gain(by_u, by_load.reshape(3, points, 3), by_theta, equilibrium, point)


@dataclass(frozen=True, eq=False)
class Curve:
    """Motion of the tip while one input runs over part of its range, all others zero (Fig. 11).

    Attributes:
        part: input over its range, (count,).
        tip: (count, 3) in m in G.
        slope: of the tip by the part, (count, 3) in m, from G.
    """

    part: np.ndarray
    tip: np.ndarray
    slope: np.ndarray

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Curve({len(self.part)} points from {self.part[0]:.3g} to {self.part[-1]:.3g} of the range)"


def input_curve(
    model: CompiledModel, actuation: Literal["pressure", "tension"], actuator: str, low: float = 0.10, high: float = 0.20, count: int = 21
) -> Curve:
    """Tip against one input over part of its range, all others zero, as in Fig. 11.

    Args:
        model: compiled model.
        actuation: which of the actuator's inputs.
        actuator: its name ("13").
        low, high: ends of the part, 0 … 1.
        count: of operating points.

    Raises:
        InputError: no such actuator.
        ValueError: an operating point is not stable.
    """
    names = model.layout.actuator_names
    if actuator not in names:
        raise unknown_name("actuator", actuator, names)
    at = names.index(actuator) + (len(names) if actuation == "tension" else 0)
    parts, tips, slopes, last = np.linspace(low, high, count), [], [], None
    for part in parts:
        inputs = np.zeros(model.layout.inputs)
        inputs[at] = part * model.input_max[at]
        last = solve_statics(model, inputs, start=last)
        tips.append(last.tip)
        slopes.append(solve_gain(last).normalise()[:, at])
    return Curve(parts, np.array(tips), np.array(slopes))


@dataclass(frozen=True, eq=False)
class WorkspaceMap:
    """G over equal-curvature configurations in a plane through the base axis.

    Attributes:
        across, height: grid of tip positions from the base plate, across and along its axis, (columns,) and (rows,) in m.
        reached: whether a grid point is within reach, (rows, columns).
        gains: Gain by grid point; None out of reach.
    """

    across: np.ndarray
    height: np.ndarray
    reached: np.ndarray
    gains: list[list[Gain | None]]

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"WorkspaceMap({len(self.across)} x {len(self.height)} tips, {int(self.reached.sum())} of them within reach)"

    def values(self, of: Callable[[Gain], float]) -> np.ndarray:
        """A number of every gain, (rows, columns); NaN out of reach."""
        return np.array([[np.nan if gain is None else of(gain) for gain in row] for row in self.gains])


def workspace_map(
    model: CompiledModel,
    across: Sequence[float] | np.ndarray,
    height: Sequence[float] | np.ndarray,
    direction: float = 0.0,
    mode: ActuationMode = ActuationMode.HYBRID,
    progress: Progress = silent,
    executor: Executor | None = None,
) -> WorkspaceMap:
    """G on a grid of tip positions in a plane through the base axis, row by row.

    Args:
        model: compiled model.
        across: distances from the base axis, (columns,) in m.
        height: distances from the base plate along its axis, (rows,) in m.
        direction: of the plane about the base axis, rad.
        mode: how the forces are made.
        progress: told of every row of the grid.
        executor: where rows are computed; here, one after the other, where None.
    """
    across, height = np.asarray(across, dtype=float), np.asarray(height, dtype=float)
    mount = model.robot.mount
    local = [np.array([[a * np.cos(direction), a * np.sin(direction), z] for a in across]) for z in height]
    targets = [row @ mount.rotation.T + mount.base_position_m for row in local]
    done = dict(track(each_done(partial(_gains_at, model, mode), targets, executor), progress, "workspace", len(targets)))
    rows = [done[k] for k in range(len(targets))]
    return WorkspaceMap(across, height, np.array([[gain is not None for gain in row] for row in rows]), rows)


def _gains_at(model: CompiledModel, mode: ActuationMode, targets: np.ndarray) -> list[Gain | None]:
    """G at targets (targets, 3) in G, each found from the one before."""
    return [gain_at(configuration) for configuration in each_configuration(model, targets, mode)]


def gain_at(configuration: Configuration) -> Gain | None:
    """G at the set points of a configuration; None where its target is out of reach or its equilibrium not stable."""
    if not configuration.solved:
        return None
    at = configuration.equilibrium
    held = solve_statics(at.model, configuration.allocation.inputs, at.loads, start=at)
    return solve_gain(held) if held.solved else None

"""An operating point of the arm: set by hand, or found for a tip that is dragged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tepm_opt.models.compile import CompiledModel
from tepm_opt.outcome import Ending
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.kinematics.ik import Configuration, solve_ik
from tepm_opt.solvers.linear.gain import Actuation, Gain, solve_gain
from tepm_opt.solvers.mechanics.statics import Equilibrium, solve_statics

FULL = 1e-9  # part of its range within which an input is at its maximum
MODE = ActuationMode.HYBRID
KINDS: tuple[Actuation, Actuation] = ("pressure", "tension")


@dataclass(frozen=True, eq=False)
class OperatingPoint:
    """The arm under inputs, and how it came to them.

    Attributes:
        held: equilibrium under the inputs.
        gain: G there; None where it is not stable.
        asked: configuration sought for a tip that was dragged; None where the inputs were set.
    """

    held: Equilibrium
    gain: Gain | None
    asked: Configuration | None = None

    def __repr__(self) -> str:
        """Summarize outcome and tip in a line."""
        return f"OperatingPoint({self.held!r}{'' if self.asked is None else f', {self.asked!r}'})"

    @property
    def limits(self) -> tuple[str, ...]:
        """Limits that bind, as "pressure_13 at its maximum": of the search for a dragged tip, or of inputs that are set."""
        if self.asked is not None:
            return self.asked.limits
        model, inputs = self.held.model, self.held.inputs
        names = [f"{kind}_{name}" for kind in KINDS for name in model.layout.actuator_names]
        full = inputs >= (1 - FULL) * model.input_max
        return tuple(f"{name} at its maximum" for name, hit in zip(names, full, strict=True) if hit)

    @property
    def bound(self) -> np.ndarray:
        """Whether a limit of the actuator binds, (modules · actuators,) of bool."""
        told = {limit.split()[0].partition("_")[2] for limit in self.limits}
        return np.array([name in told for name in self.held.model.layout.actuator_names])

    def ellipsoid(self, kind: Actuation, share: float) -> tuple[np.ndarray, np.ndarray] | None:
        """Find the ellipsoid of tips reached by changes of inputs of Euclidean length `share`, each over its own range, to first order.

        Args:
            kind: which inputs.
            share: of the ranges.

        Returns:
            Semi-axes (3,) in m, largest first, and their directions in G as columns (3, 3), right-handed; None where G is not known.
        """
        if self.gain is None:
            return None
        directions, lengths, _ = np.linalg.svd(self.gain.normalise(kind))
        directions[:, 2] *= np.sign(np.linalg.det(directions))
        return share * lengths, directions


def set_inputs(model: CompiledModel, inputs: Sequence[float] | np.ndarray, last: OperatingPoint | None = None) -> OperatingPoint:
    """The operating point under inputs; they are brought within their ranges.

    Args:
        model: compiled model.
        inputs: u, (2 · modules · actuators,) in Pa and N.
        last: an operating point nearby, to start from.
    """
    inputs = np.clip(np.asarray(inputs, dtype=float), 0.0, model.input_max)
    near = last.held if last is not None and last.held.solved else None
    held = solve_statics(model, inputs, start=near)
    return OperatingPoint(held, _gain(held))


def drag_tip(
    model: CompiledModel, target: Sequence[float] | np.ndarray, mode: ActuationMode = MODE, last: OperatingPoint | None = None
) -> OperatingPoint:
    """The operating point whose tip is at a target, or as near as the limits allow.

    Where the search fails the arm stays where it was, and `asked` says why.

    Args:
        model: compiled model.
        target: tip position in G, (3,) in m.
        mode: how axial forces are made.
        last: an operating point nearby, to start from.

    Raises:
        InputError: the target is not three finite numbers.
    """
    start = last.asked if last is not None and last.asked is not None and last.asked.solved else None
    found = solve_ik(model, target, mode, start=start)
    if found.outcome.ending is Ending.FAILED:
        kept = set_inputs(model, np.zeros(model.layout.inputs)) if last is None else last
        return OperatingPoint(kept.held, kept.gain, found)
    held = solve_statics(model, found.allocation.inputs, start=found.equilibrium)
    return OperatingPoint(held, _gain(held), found)


def off_grid(point: OperatingPoint) -> float:
    """Distance in m by which the tip misses its place under the inputs that the actuators' grids have; NaN where that is not stable."""
    held, asked = point.held, point.asked
    sought = asked is not None and asked.outcome.ending is not Ending.FAILED
    inputs = asked.allocation.rounded if asked is not None and sought else held.model.robot.actuation.on_grid(held.inputs)
    there = solve_statics(held.model, inputs, start=held)
    return float(np.linalg.norm(there.tip - held.tip)) if there.solved and held.solved else float("nan")


def _gain(held: Equilibrium) -> Gain | None:
    try:
        return solve_gain(held)
    except ValueError:  # not stable
        return None

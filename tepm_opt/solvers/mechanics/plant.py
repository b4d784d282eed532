"""Interface of a model of any machine for identification and the search for missing effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tepm_opt.data.run import Run

START = "start: "
"""Before the name of a state: its value at the first row of a run."""


class PredictionError(RuntimeError):
    """A model cannot say what a run measured: it has no equilibrium or no motion there; the message names run and place."""


@dataclass(frozen=True)
class Free:
    """A parameter to be found.

    Attributes:
        name: full name ("K_a", "payload.mass").
        unit: SI.
        start: first value.
        low, high: its range; for a robot parameter with a prior the prior's (SPEC section 4: uniform).
        scale: a small but visible change of it.
        prior_mean, prior_std: of a normal prior besides the range; infinite standard deviation for none.
        group: of alike parameters whose common `prior_std` the data tell (see `hierarchy`); none where empty.
        refines: whether it refines how something acts that acts without it, too: a corner, a bend.
        changed: whether an effect says that its value is another than before, so that earlier data tell nothing of it.
    """

    name: str
    unit: str
    start: float
    low: float
    high: float
    scale: float
    prior_mean: float = 0.0
    prior_std: float = np.inf
    group: str = ""
    refines: bool = False
    changed: bool = False

    @property
    def spread(self) -> float:
        """Standard deviation of what is known before any data: of a uniform distribution over a finite range, else wide."""
        width = self.high - self.low
        if np.isfinite(self.prior_std):
            return self.prior_std
        return max(width / np.sqrt(12), 1e-6 * self.scale) if np.isfinite(width) else 1e3 * self.scale


@dataclass(frozen=True, eq=False)
class Prediction:
    """Prediction of a run by a model.

    Attributes:
        points: what is measured, as in the run, (rows, points, axes), in its units.
        by: its change with each parameter asked for, (parameters, rows, points, axes) per the parameter's unit.
    """

    points: np.ndarray
    by: np.ndarray

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Prediction({len(self.points)} rows of {self.points.shape[1]} points, by {len(self.by)} parameters)"


class Plant(Protocol):
    """A model of a machine with values of its parameters.

    The network of masses and springs is one (`network_plant.NetworkPlant`); anything that can be simulated is another. The effects that
    may be missing in it are parameters at values at which they vanish.

    Attributes:
        values: of all parameters, by full name.
        concurrent: whether runs may be predicted at the same time, in threads.
        static: whether rows of its runs are equilibria, not samples of a motion.
        quick: whether a run takes so little time that left-out data are judged by fits of their own.
        states: by name, those with which a run may begin that does not begin at rest, with a guess of each.
    """

    @property
    def states(self) -> Mapping[str, float]: ...

    @property
    def values(self) -> Mapping[str, float]: ...

    @property
    def concurrent(self) -> bool: ...

    @property
    def static(self) -> bool: ...

    @property
    def quick(self) -> bool: ...

    def with_values(self, values: Mapping[str, float]) -> Plant:
        """The model with other values of some parameters."""
        ...

    def free(self, names: Sequence[str]) -> tuple[Free, ...]:
        """These parameters, to be found within their ranges from the values they have.

        Raises:
            InputError: no such parameter; a value outside its range.
        """
        ...

    def predict(self, run: Run, by: Sequence[str] = (), step: float = np.inf) -> Prediction:
        """Predict what a run should have measured.

        Args:
            run: what was done; what it measured is not looked at.
            by: parameters by full name by which to differentiate, or `START` with the name of a state.
            step: longest time step in s that the caller's use of the answer bears; the model may take shorter ones.

        Raises:
            PredictionError: the model cannot do the run.
        """
        ...

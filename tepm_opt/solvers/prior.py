"""Joint normal prior of several parameters, such as the posterior of an earlier fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tepm_opt.solvers.plant import Free


@dataclass(frozen=True, eq=False)
class JointPrior:
    """Normal distribution of parameters that are correlated.

    Attributes:
        names: full names of the parameters.
        mean: (parameters,), SI.
        covariance: (parameters, parameters), SI.
        weight: samples of the data fitted to that say as much as one independent measurement. The squares of a fit count each sample as
            independent; the prior counts as much more.
    """

    names: tuple[str, ...]
    mean: np.ndarray
    covariance: np.ndarray
    weight: float = 1.0

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"JointPrior({len(self.names)} parameters, weight {self.weight:.3g})"

    @property
    def std(self) -> np.ndarray:
        """Standard deviations, (parameters,)."""
        return np.sqrt(np.diag(self.covariance))

    def terms(self, free: Sequence[Free]) -> tuple[np.ndarray, np.ndarray]:
        """Mean, (free parameters,), and precision times weight, (free parameters,) squared, of the marginal distribution.

        Both are 0 for parameters that it does not tell, and for those whose value an effect has changed (`Free.changed`).
        """
        at = [k for k, each in enumerate(free) if each.name in self.names and not each.changed]
        own = [self.names.index(free[k].name) for k in at]
        mean, precision = np.zeros(len(free)), np.zeros((len(free), len(free)))
        if at:
            mean[at] = self.mean[own]
            scale = self.std[own]
            correlation = self.covariance[np.ix_(own, own)] / np.outer(scale, scale)
            precision[np.ix_(at, at)] = self.weight * np.linalg.pinv(correlation, rcond=1e-12, hermitian=True) / np.outer(scale, scale)
        return mean, precision

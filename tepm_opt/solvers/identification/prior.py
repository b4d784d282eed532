"""Joint normal prior of several parameters, such as the posterior of an earlier fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.documents import read_json
from tepm_opt.errors import InputError
from tepm_opt.solvers.mechanics.plant import Free


@dataclass(frozen=True, eq=False)
class JointPrior:
    """Normal distribution of parameters that are correlated.

    Attributes:
        names: full names of the parameters.
        mean: (parameters,), SI.
        covariance: (parameters, parameters), SI.
        weight: samples of the data fitted to that say as much as one independent measurement. The squares of a fit count each sample as
            independent; the prior counts as much more.
        units: of the parameters.
    """

    names: tuple[str, ...]
    mean: np.ndarray
    covariance: np.ndarray
    weight: float = 1.0
    units: tuple[str, ...] = ()

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

    def as_json(self) -> dict[str, Any]:
        """Means, standard deviations, units and covariance as plain data, SI."""
        told = zip(self.names, self.mean.tolist(), self.std.tolist(), self.units or [""] * len(self.names), strict=True)
        parameters = [{"name": name, "mean": mean, "std": std, "unit": unit} for name, mean, std, unit in told]
        return {"parameters": parameters, "covariance": self.covariance.tolist(), "weight": self.weight}

    @classmethod
    def from_file(cls, file: Path) -> JointPrior:
        """The distribution in a `posterior.json` of tepm identify or a `baseline.json` of tepm discrepancy.

        Raises:
            InputError: it cannot be read, or holds none.
        """
        return cls.from_json(read_json(file, "tepm identify"), file)

    @classmethod
    def from_json(cls, content: Mapping[str, Any], file: Path) -> JointPrior:
        """A distribution that `as_json` wrote.

        Args:
            content: of the file.
            file: that it was read from, for messages.

        Raises:
            InputError: something is missing, or the covariance is not one.
        """
        try:
            told = list(content["parameters"])
            names, units = tuple(str(each["name"]) for each in told), tuple(str(each.get("unit", "")) for each in told)
            mean, covariance = np.array([float(each["mean"]) for each in told]), np.array(content["covariance"], dtype=float)
            weight = float(content.get("weight", 1.0))
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{file}: no posterior: {error!r}; valid: parameters (name, mean, unit) and covariance") from error
        if len(set(names)) != len(names) or covariance.shape != (len(names), len(names)):
            raise InputError(f"{file}: covariance: {covariance.shape} for {len(names)} parameters; valid: one row and column each")
        valid = np.all(np.isfinite(covariance)) and np.all(np.isfinite(mean)) and weight > 0 and np.all(np.diag(covariance) > 0)
        scale = np.sqrt(np.abs(np.diag(covariance))) if valid else np.ones(len(names))
        correlation = covariance / np.outer(scale, scale)
        if not valid or not np.allclose(correlation, correlation.T, atol=1e-6) or np.linalg.eigvalsh(correlation).min(initial=0.0) < -1e-6:
            raise InputError(f"{file}: covariance: is none; valid: finite, symmetric, positive, as it was written")
        return cls(names, mean, covariance, weight, units)

"""Error of a model as the residuals of a fit show it: size by channel, memory in time, scatter between recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.baseline.settings import DEFAULT, BaselineSettings
from tepm_opt.discrepancy.selection.cross_validation import Evidence
from tepm_opt.errors import InputError
from tepm_opt.solvers.identification.identify import ParameterEstimate
from tepm_opt.solvers.identification.residuals import independent_after


@dataclass(frozen=True, eq=False)
class ModelError:
    """Error of a fitted model, noise included.

    Attributes:
        size: root mean square of each point on data left out of the fit, (points, 1), in the points' units.
        lasts: time in s after which the error has forgotten: its integrated autocorrelation.
        weight: samples that say as much as one independent measurement.
        scatter: standard deviation of the mean square of one block of time that lasts so long, over the mean square.
        blocks: number of these blocks.
    """

    size: np.ndarray
    lasts: float
    weight: float
    scatter: float
    blocks: int

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"ModelError(lasts {self.lasts:.3g} s, {self.blocks} blocks, a sample weighs 1/{self.weight:.3g})"

    def chance(self, blocks: int, settings: BaselineSettings = DEFAULT) -> float:
        """Share by which the mean square of another recording of so many blocks may be larger by chance."""
        return settings.chance_sigmas * self.scatter * float(np.sqrt(1 / self.blocks + 1 / max(blocks, 1)))

    def count_blocks(self, runs: Sequence[Run]) -> int:
        """Independent blocks of time in some runs; rows, where these are equilibria."""
        return int(sum(_seconds(run) / self.lasts if self.lasts > 0 else run.rows for run in runs))

    def as_json(self) -> dict[str, Any]:
        """Plain data, SI."""
        return asdict(self) | {"size": self.size[:, 0].tolist()}

    @classmethod
    def from_json(cls, content: Any, file: Path) -> ModelError:
        """An error that `as_json` wrote.

        Args:
            content: of the file's part.
            file: that it was read from, for messages.

        Raises:
            InputError: something is missing or no valid number.
        """
        valid = "valid: model_error as tepm discrepancy --baseline writes it: size, lasts, weight, scatter, blocks"
        try:
            size = np.array(content["size"], dtype=float)[:, None]
            lasts, weight, scatter = (float(content[name]) for name in ("lasts", "weight", "scatter"))
            found = cls(size, lasts, weight, scatter, int(content["blocks"]))
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise InputError(f"{file}: no model error ({error!r}); {valid}") from error
        numbers = [*found.size[:, 0], found.weight, found.lasts + 1, found.scatter + 1, found.blocks]
        if not all(np.isfinite(value) and value > 0 for value in numbers) or found.lasts < 0 or found.scatter < 0:
            raise InputError(f"{file}: model_error has a number that none can have; {valid}")
        return found


def estimate_model_error(estimate: ParameterEstimate, evidence: Evidence, name: str, settings: BaselineSettings = DEFAULT) -> ModelError:
    """Error of a fitted model on the data that it was fitted to.

    Args:
        estimate: the fit, with its residuals.
        evidence: predictions of left-out data by the same model, whose squares exceed the residuals'.
        name: of the data, for messages.
        settings: thresholds.

    Raises:
        InputError: the data hold too few independent blocks.
    """
    problem, residuals = estimate.problem, estimate.residuals
    seen = sum(r.squares for r in residuals) / max(sum(r.count for r in residuals), 1)
    held_out = max(float(evidence.squares.sum()) / max(evidence.count, 1) / max(seen, 1e-12), 1.0)
    squares = sum((np.square(r.values * sigma)).sum(axis=(0, 2)) for r, sigma in zip(residuals, problem.noises, strict=True))
    counts = np.maximum(sum(r.present.sum(axis=(0, 2)) for r in residuals), 1)
    size = np.sqrt(held_out * np.asarray(squares) / counts)[:, None]
    noise = np.max([np.broadcast_to(np.asarray(sigma, dtype=float), size.shape) for sigma in problem.noises], axis=0)
    static = problem.plant.static
    lasts = 0.0 if static else independent_after(residuals, problem.runs)
    step = 1.0 if static else max(float(np.median(np.diff(run.time))) for run in problem.runs if run.rows > 1)
    block = _mean_squares(estimate, lasts)
    if len(block) < settings.min_blocks:
        raise InputError(
            f"{name}: the model's error lasts {lasts:.3g} s, so that the data hold {len(block)} independent pieces; "
            f"valid: a baseline of at least {settings.min_blocks}"
        )
    scatter = float(np.std(block) / max(np.mean(block), 1e-300))
    return ModelError(np.fmax(size, noise), lasts, max(lasts / step, 1.0), scatter, len(block))


def _mean_squares(estimate: ParameterEstimate, lasts: float) -> np.ndarray:
    """Mean squares of the residuals in blocks of time, (blocks,); of rows where these are equilibria."""
    found = []
    for r, run in zip(estimate.residuals, estimate.problem.runs, strict=True):
        number = np.arange(run.rows) if lasts <= 0 else np.floor((run.time - run.time[0]) / lasts + 1e-9).astype(int)
        squares = np.bincount(number, np.square(r.values).reshape(run.rows, -1).sum(axis=1))
        counts = np.bincount(number, r.present.reshape(run.rows, -1).sum(axis=1))
        found.append(squares[counts > 0] / counts[counts > 0])
    return np.concatenate(found)


def _seconds(run: Run) -> float:
    """Length of a run in s, its last sample included."""
    return float(np.ptp(run.time)) * run.rows / max(run.rows - 1, 1) if run.rows > 1 else 0.0

"""Learning over rounds: what a path is missed by again and again is taken off the next target.

Iterative learning control on top of the closed loop: with e what the tip was short of the path in round k,

    c[k + 1](t) = c[k](t) + g[k] Q e[k](t + lead),

is added to the path that the controller is given. Q is a low pass without phase, as what does not repeat (noise, sway) is mostly quick;
gains g fall, so that noise is averaged over the rounds. Bristow, Tharayil, Alleyne, A survey of iterative learning control, IEEE Control
Systems Magazine 26(3), 2006; falling gains: Saab, IEEE TAC 46(12), 2001.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfiltfilt

from tepm_opt.control.references.reference import minimum_jerk
from tepm_opt.errors import InputError


@dataclass(frozen=True)
class LearningSettings:
    """Settings of learning from round to round; tried on machines of seed 900 (`hw.simulation.family`).

    Attributes:
        gain: part of the error that the first round teaches.
        fading: by which gains fall: round k, from 0, teaches gain / (1 + fading k).
        bandwidth: frequency in Hz above which an error is not believed to repeat.
        lead: time in s by which the loop follows its target late.
        largest: distance in m by which no target is corrected more.
        begin: time in s from rest over which corrections come in.
        worse: a round with so many times the smallest error goes back to the best correction, with half the gain.
    """

    gain: float = 0.8
    fading: float = 0.35
    bandwidth: float = 2.0
    lead: float = 0.02
    largest: float = 0.03
    begin: float = 1.0
    worse: float = 1.15


DEFAULT = LearningSettings()


class Learner:
    """Correction of a path, learned over rounds.

    Args:
        path: where the tip shall be, (periods, 3) in m.
        period: s.
        settings: how it learns.
        correction: known from before, (periods, 3) in m.

    Attributes:
        correction: to add to the path for the next round, (periods, 3) in m.
        errors: of the rounds, root mean squares in m of what was tracked.

    Raises:
        InputError: a correction of another path, or one that is too large.
    """

    def __init__(self, path: np.ndarray, period: float, settings: LearningSettings = DEFAULT, correction: np.ndarray | None = None) -> None:
        if correction is not None and correction.shape != path.shape:
            raise InputError(f"correction: {len(correction)} targets; valid: {len(path)}, as many as this path has")
        if correction is not None and (most := np.linalg.norm(correction, axis=1).max()) > settings.largest * (1 + 1e-9):
            raise InputError(f"correction: up to {1e3 * most:g} mm; valid: at most {1e3 * settings.largest:g} mm (columns are in m)")
        self.path, self.period, self.settings = path, period, settings
        self.correction = np.zeros_like(path) if correction is None else correction
        self.best, self.errors, self._part = self.correction, list[float](), 1.0

    def __repr__(self) -> str:
        told = ", ".join(f"{1e3 * error:.2f}" for error in self.errors)
        return f"Learner({len(self.path)} targets, rounds: [{told}] mm)"

    def learn(self, rows: np.ndarray, tips: np.ndarray, counted: np.ndarray) -> None:
        """Take a round.

        Args:
            rows: of the path, one a sample, (samples,).
            tips: tracked, (samples, 3) in m; NaN where lost.
            counted: over which samples the error counts, (samples,) of bool.
        """
        short = self.path[rows] - tips
        seen = np.isfinite(short).all(axis=1)
        if not (seen & counted).any():
            return
        error = float(np.sqrt((short[seen & counted] ** 2).sum(axis=1).mean()))
        if self.errors and error > self.settings.worse * min(self.errors):
            self._part /= 2
            taken = self.best + (self.correction - self.best) / 2
        else:
            if not self.errors or error <= min(self.errors):
                self.best = self.correction
            gain = self._part * self.settings.gain / (1 + self.settings.fading * len(self.errors))
            taken = self.correction + gain * self._filter_repeating_error(rows[seen], short[seen])
        self.errors.append(error)
        length = np.linalg.norm(taken, axis=1, keepdims=True)
        self.correction = taken * np.minimum(1.0, self.settings.largest / np.maximum(length, 1e-12))

    def _filter_repeating_error(self, rows: np.ndarray, short: np.ndarray) -> np.ndarray:
        """Part of the tip's error that may repeat, at every target, (periods, 3) in m; linear between samples."""
        settings, every = self.settings, np.arange(len(self.path))
        whole = np.stack([np.interp(every, rows, column) for column in short.T], axis=1)
        low_pass = butter(2, 2 * settings.bandwidth * self.period, output="sos")
        slow = sosfiltfilt(low_pass, whole, axis=0, padlen=min(len(whole) - 1, round(1 / (settings.bandwidth * self.period))))
        early = slow[np.minimum(every + round(settings.lead / self.period), len(every) - 1)]
        return early * minimum_jerk(every * self.period / settings.begin)[:, None]

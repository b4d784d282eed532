"""Pressure monitors that read what was some time ago, or regulators with a dead time: both throw an arm whose valves are quick.

Several hypotheses about delay and lags predict the readings from the commands side by side, and the likeliest is believed (multiple-model
estimation; Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 11.6). A lag alone begins
to act at once, so steps of the commands tell it from a delay. Scale and offset of each monitor are fitted by least squares.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np

DELAYS = (0.0, 0.03, 0.06, 0.09, 0.12, 0.18)  # s
IN_TIME = 0.045  # s, up to which a delay is that of commands and line
LAGS = (0.002, *np.geomspace(0.03, 1.0, 9))  # time constants in s, of filling and exhausting apart
SURE = 200.0  # log-odds of all monitors together for a delay beyond that: at most 0 in 29 runs with monitors in time, above with late ones
FORGOTTEN = 3.0  # s over which readings count
WATCHED = 4.0  # s of readings: what delays a line does not begin later, and real delays were found within 2.7 s
EVERY = 10  # samples between looks


class MonitorDelay:
    """Delay of all pressure monitors beside the regulators' lags.

    Args:
        period: of the samples in s.

    Attributes:
        late: in s; 0 as long as nothing says so.
    """

    def __init__(self, period: float) -> None:
        self._period, self._time, self.late = period, -np.inf, 0.0
        self._delays = np.unique(np.round(np.array(DELAYS) / period).astype(int))
        lags = np.array(np.meshgrid(LAGS, LAGS)).reshape(2, -1)
        self._shares = -np.expm1(-period / lags)[:, None, :, None]  # of what is missing, of filling and exhausting
        self._commands: deque[np.ndarray] = deque(maxlen=int(self._delays[-1]) + 2)  # the latest first
        self._path = np.zeros(0)  # (delays, lags, monitors)
        self._count, self._means, self._products = 0, (np.zeros(0), np.zeros(0)), (np.zeros(0),) * 3

    def look(self, time: float, readings: np.ndarray | None, command: np.ndarray) -> bool:
        """Take a sample's readings and the command that it led to; whether it shows that the monitors are late.

        Args:
            time: of the sample in s; after a gap everything begins anew.
            readings: (actuators,) in Pa, NaN where there is none; None without monitors.
            command: (actuators,) in Pa.
        """
        if self.late or readings is None or self._count * self._period > WATCHED:
            return False
        if not 0.5 * self._period < time - self._time < 1.5 * self._period:
            self._restart(readings)
        else:
            self._compare(readings)
        self._time = time
        self._commands.appendleft(command)
        if self._count and self._count % EVERY == 0:
            self._decide()
        return self.late > 0

    def describe(self) -> Mapping[str, str]:
        """Sentence where the monitors are late, by its key in the log."""
        if not self.late:
            return {}
        text = f"pressures follow their commands {1e3 * self.late:.0f} ms later than a lag would let them"
        return {"pressure monitors": f"{text}: late monitors, or dead times of the regulators; the controller goes by the tracked points"}

    def _restart(self, readings: np.ndarray) -> None:
        self._path = np.broadcast_to(readings, (len(self._delays), self._shares.shape[2], len(readings)))
        self._count, self._means, none = 0, (self._path, readings), np.zeros(self._path.shape)
        self._products = none, none, np.zeros(len(readings))
        self._commands.clear()

    def _compare(self, readings: np.ndarray) -> None:
        """Carry what commands lead to a period on, and compare it with readings; a command acts in the midst of its first period."""
        at = [np.minimum(self._delays + k, len(self._commands) - 1) for k in (0, 1)]
        sent = np.array(self._commands)
        missing = ((sent[at[0]] + sent[at[1]]) / 2)[:, None] - self._path
        self._path = self._path + np.where(missing > 0, *self._shares) * missing
        self._count += 1
        share, there = 1 / min(self._count + 1, FORGOTTEN / self._period), np.isfinite(readings)
        x, y = (np.where(there, now - mean, 0.0) for now, mean in zip((self._path, readings), self._means, strict=True))
        self._means = self._means[0] + share * x, self._means[1] + share * y
        self._products = tuple(  # type: ignore[assignment]
            (1 - share) * (before + share * now) for before, now in zip(self._products, (x * x, x * y, y * y), strict=True)
        )

    def _decide(self) -> None:
        """Compare the likeliest hypotheses with and without a delay."""
        xx, xy, yy = self._products
        best = np.fmax((yy - xy**2 / np.fmax(xx, 1.0)).min(axis=1), 1.0)  # Pa²
        likelihood = -0.5 * min(self._count, FORGOTTEN / self._period) * np.log(best).sum(axis=1)
        beyond = self._delays * self._period > IN_TIME
        if likelihood[beyond].max() - likelihood[~beyond].max() > SURE:
            self.late = float(self._delays[beyond][np.argmax(likelihood[beyond])] * self._period)

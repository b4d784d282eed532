"""A base that moves to and fro."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np
from scipy.fft import next_fast_len
from scipy.ndimage import median_filter

from tepm_opt.models.effect import BEGAN, CLOCK, Context, Effect, Parameter, Properties

FINE = 8  # frequencies to one that the session's length resolves
AROUND, SLOWEST = 0.25, 0.5  # Hz: surroundings of a line, and below which it is no vibration
CONTRAST = 20.0  # times the median of its surroundings above which it is surely a line; sway that decays has less
ALIKE = 0.8  # part of a line from which it is one motion of all points


class BaseVibration(Effect):
    """The base plate moves as a sine of one frequency along each axis of the tracker frame G, with a second harmonic of the same shape.

    Its phase is the session's, or, as of a pump that starts with the recording, begins anew with each run (`restarts` is 1).

    In the base's frame the masses feel its acceleration, turned round; the tracker sees their motion in that frame and the base's.
    `inertia` is 1 where the base moves and the tracker stands, 0 where the tracker's stand moves and the robot's does not. A run begins
    at rest and statics are of its beginning: there the masses feel nothing yet, but ever more within `rise`.
    """

    name = "base_vibration"
    explains = "the base moves to and fro"
    reference = "base excitation; Meirovitch, Fundamentals of Vibrations, 2001, section 2.6"
    timed = True
    parameters = (
        *(Parameter(f"sine_{axis}", "m", null=0.0, probe=2e-4, low=-0.05, high=0.05) for axis in "xyz"),
        *(Parameter(f"cosine_{axis}", "m", null=0.0, probe=2e-4, low=-0.05, high=0.05) for axis in "xyz"),
        Parameter("frequency", "Hz", null=3.0, probe=3.0, low=0.1, high=50.0, change=0.01),
        Parameter("restarts", "1", null=0.0, probe=0.0, low=0.0, high=1.0, change=0.1),
        Parameter("inertia", "1", null=1.0, probe=1.0, low=0.0, high=1.0),
        Parameter("rise", "s", null=0.5, probe=0.5, low=0.02, high=5.0, change=0.1),
        *(Parameter(f"harmonic_{part}", "1", null=0.0, probe=0.0, low=-1.0, high=1.0, change=0.1) for part in ("sine", "cosine")),
    )

    further_shapes = ({"rise": 0.03, "inertia": 1.0},)  # it sets in at once, and the arm sways after that

    def loads(self, properties: Properties, external: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        passed = (parameters[CLOCK] - parameters[BEGAN]) / parameters["rise"]
        pull = self._wave(parameters, 1) + 4 * self._wave(parameters, 2)
        force = parameters["inertia"] * -ca.expm1(-(passed**2)) * (2 * np.pi * parameters["frequency"]) ** 2 * pull
        return context.layout.actuators * ca.mtimes(ca.mtimes(ca.DM(context.rotation.T), force), properties.mass.T)

    def outputs(self, points: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        return points + ca.repmat(self._wave(parameters, 1) + self._wave(parameters, 2), 1, context.layout.points)

    @staticmethod
    def _wave(parameters: Mapping[str, ca.SX], order: int) -> ca.SX:
        """Part of a harmonic, the first or the second, in the place of the base in G beside where it rests, (3,) in m."""
        phase = order * 2 * np.pi * parameters["frequency"] * (parameters[CLOCK] - parameters["restarts"] * parameters[BEGAN])
        sine, cosine = (ca.vertcat(*(parameters[f"{part}_{axis}"] for axis in "xyz")) for part in ("sine", "cosine"))
        seen, shifted = sine * ca.sin(phase) + cosine * ca.cos(phase), sine * ca.cos(phase) - cosine * ca.sin(phase)
        return seen if order == 1 else parameters["harmonic_sine"] * seen + parameters["harmonic_cosine"] * shifted

    def suggest_values(self, clock: np.ndarray, began: np.ndarray, left: np.ndarray) -> Mapping[str, float]:
        """The line with most power above its surroundings in the spectrum of all runs together, with phases of either kind.

        Where none is surely a line it is what stands out most. Where all points move alike in it, it is the tracker's stand that moves.
        """
        step, starts = float(np.median(np.diff(clock))), np.unique(began)
        length = next_fast_len(int(FINE * (clock[-1] - clock[0]) / step) + 1, real=True) or 1
        frequency = np.fft.rfftfreq(length, step)
        alone = []
        for start in starts:
            run = began == start
            samples = np.zeros((length, left.shape[1]))
            samples[np.round((clock[run] - start) / step).astype(int)] = left[run] - left[run].mean(axis=0)
            alone.append(np.fft.rfft(samples, axis=0))
        turned = [np.exp(-2j * np.pi * frequency * start)[:, None] * own for start, own in zip(starts, alone, strict=True)]
        around = 2 * int(AROUND / frequency[1]) + 1
        best = ((0.0, 0.0), {})
        for restarts, parts in ((0.0, turned), (1.0, alone)):
            lines = np.sum(parts, axis=0)
            power = np.sum(np.abs(lines) ** 2, axis=1)
            middle = np.maximum(median_filter(power, around, mode="nearest"), 1e-30)
            above = np.where(frequency > SLOWEST, np.maximum(power - CONTRAST * middle, 0.0), 0.0)
            at = int(np.argmax(above if above.any() else np.where(frequency > SLOWEST, power / middle, 0.0)))
            moves = lines[at].reshape(-1, 3)  # every point along every axis
            alike = len(moves) * np.sum(np.abs(moves.mean(axis=0)) ** 2) > ALIKE * power[at]
            found = {"frequency": float(frequency[at]), "restarts": restarts, "inertia": 0.0 if alike else 1.0}
            best = max(best, ((float(above[at]), float(power[at])), found), key=lambda line: line[0])
        return best[1]

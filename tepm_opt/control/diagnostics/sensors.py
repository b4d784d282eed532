"""Warnings while a loop is closed: gauges that lie or devices that do not follow, commands that act later and a tracker
that is noisier than the robot file says."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np

from tepm_opt.control.actuation.regulator_lags import RegulatorFindings

WINDOW = 100  # samples over which the tracker's noise is taken
EVERY = 20  # samples between looks at it
NOISY = 1.6  # times the noise declared, that is told
SLOWEST, LARGEST = 0.5, 6.0  # times the noise declared: bounds of what is believed
OFF = {"tension": 0.02, "pressure": 0.03}  # of the range: difference between gauge and device that is told
STAYS = 50  # samples for which it has to stay
LATE = 12e-3  # s by which commands act later or sooner than declared, that is told
QUICKER = 2.0  # times quicker or slower than declared, that a regulator's lags are told
THIRD = np.array([1.0, -3.0, 3.0, -1.0])  # difference that leaves white noise and hardly any motion


class TrackerNoise:
    """Noise of the tracked points, from their third differences: motion of an arm hardly shows in them.

    Args:
        declared: of a coordinate, 1 sigma in m, as the robot file says.

    Attributes:
        measured: of a coordinate in m over the last second, within bounds about what is declared; what is declared at the start.
    """

    def __init__(self, declared: float) -> None:
        self.declared = self.measured = declared
        self._seen: deque[np.ndarray] = deque(maxlen=WINDOW)
        self._count = 0

    def add(self, points: np.ndarray) -> float:
        """Take a sample's points (points, 3) in m, NaN where missing; the noise measured, as of the last look."""
        self._seen.append(points)
        self._count += 1
        if len(self._seen) == WINDOW and self._count % EVERY == 0:
            seen = np.array(self._seen)
            rough = np.abs(sum(c * seen[k : len(seen) - 3 + k] for k, c in enumerate(THIRD)))
            rough = rough[np.isfinite(rough)]
            if len(rough):
                sigma = float(np.median(rough)) / 0.6745 / float(np.linalg.norm(THIRD))
                self.measured = float(np.clip(sigma, SLOWEST * self.declared, LARGEST * self.declared))
        return self.measured


class SensorDiagnostics:
    """Warnings about gauges, devices, delay and tracker, one sentence each.

    Args:
        names: of the actuators.
        ranges: of their pressures in Pa and of their tensions in N, (actuators,) each.

    Attributes:
        lasting: samples for which offsets of "pressure" and "tension" have been beyond their limits, (actuators,) each.
    """

    def __init__(self, names: Sequence[str], ranges: tuple[np.ndarray, np.ndarray]) -> None:
        self._names = names
        self._limits = {"pressure": OFF["pressure"] * ranges[0], "tension": OFF["tension"] * ranges[1]}
        self.lasting = {kind: np.zeros(len(names), dtype=int) for kind in self._limits}

    def count(self, offsets: Mapping[str, np.ndarray]) -> None:
        """Take a sample's offsets of "pressure" and "tension", (actuators,) each in Pa and N."""
        for kind, limit in self._limits.items():
            self.lasting[kind] = np.where(np.abs(offsets[kind]) > limit, self.lasting[kind] + 1, 0)

    def sentences(
        self, lasting: Mapping[str, np.ndarray], offsets: Mapping[str, np.ndarray], noise: tuple[float, float], late: float,
        regulators: RegulatorFindings,
    ) -> Mapping[str, str]:  # fmt: skip
        """Warnings that hold now, one sentence each, by their subject.

        Args:
            lasting: number of samples for which offsets of "pressure" and "tension" have been beyond their limits, (actuators,) each.
            offsets: what gauges read above what devices do, (actuators,) each in Pa and N.
            noise: of a tracked coordinate in m, as measured and as declared.
            late: by how much in s commands act later than the robot file says.
            regulators: differences of regulators and their monitors from the robot file.
        """
        found: dict[str, str] = {}
        for kind, gauge, device, unit, scale in (
            ("tension", "dynamometer", "motor", "N", 1.0),
            ("pressure", "pressure monitor", "regulator", "kPa", 1e-3),
        ):
            offset = offsets[kind]
            for k in np.flatnonzero(lasting[kind] > STAYS).tolist():
                name, size, way = self._names[k], float(f"{abs(scale * offset[k]):.2g}"), "low" if offset[k] < 0 else "high"
                other = "less" if offset[k] < 0 else "more"
                found[f"{gauge} {name}"] = (
                    f"{gauge} {name} reads {size:g} {unit} {way}, or {device} {name} gives that much {other} than it is told: "
                    "its readings and its commands do not say which"
                )
        for k in np.flatnonzero((regulators.noise > 0) & np.isfinite(regulators.noise)).tolist():  # without limit: told elsewhere
            name, size = self._names[k], float(f"{1e-3 * regulators.noise[k]:.2g}")
            found[f"noise of monitor {name}"] = (
                f"pressure monitor {name} has {size:g} kPa of noise, too much to be believed; the controller goes by the commands"
            )
        quicker = regulators.quicker
        for k in np.flatnonzero((np.abs(np.log(quicker)) > np.log(QUICKER)).any(axis=0)).tolist():
            fills, exhausts = quicker[:, k].tolist()
            found[f"regulator {self._names[k]}"] = (
                f"regulator {self._names[k]} fills {fills:.2g} and exhausts {exhausts:.2g} times as quickly as the robot file says; "
                "the controller goes by its pressure monitor"
            )
        if abs(np.log(regulators.common)) > np.log(QUICKER):
            found["regulators"] = (
                f"regulators without a pressure monitor act {regulators.common:.2g} times as quickly as the robot file says, or even more; "
                "the controller goes by the tracked points"
            )
        if abs(late) > LATE:
            way = "later" if late > 0 else "sooner"
            found["command delay"] = f"commands act {1e3 * abs(late):.0f} ms {way} than the robot file says; the controller goes by it"
        if noise[0] > NOISY * noise[1]:
            found["tracker noise"] = (
                f"tracked points are {noise[0] / noise[1]:.1f} times as noisy as the robot file says; the filter goes by what is measured"
            )
        return found

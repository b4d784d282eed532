"""Whether the machine is still what it was when the run began: watched beside any controller, told as a doubt with what explains it best.

No machine is its model, so the two are not compared as such: what sets them apart (strengths, friction, masses, where markers sit, and what
comes back at every place of the path) is estimated as the run goes on, and a change from some time on has to explain what that does not.
Points tell of a change only where the arm has been before: how a machine differs at a place that is new to it is not known. Gauges do
anywhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.control.controller import Controller, Prepares, Telemetry
from tepm_opt.control.diagnostics.causes import BODY, MOTOR, REGULATOR, FaultHypothesisTest, causes
from tepm_opt.control.diagnostics.change_detection import GlrStatistics, PrewhiteningFilter, Sums
from tepm_opt.control.diagnostics.signatures import BLOCK, FaultRegressors, Rows
from tepm_opt.control.references.reference import Reference
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.models.compile import CompiledModel

EVIDENCE = "change_evidence"
"""Column of the log: logarithm of the evidence for a change over none."""
ABOUT = "machine"
"""Key of the warning in the log."""


@dataclass(frozen=True)
class MonitorSettings:
    """Noise that is reckoned with and when a change is told; by likelihood on random machines of seed 71001 without a change.

    Attributes:
        begins: time in s of the run before which nothing counts.
        learns: time in s for which what sets machine and model apart is learned alone.
        every: time in s between looks, and between times at which a change may have begun.
        marks: how many of the latest of these times.
        evidence: logarithm of the odds from which a change is told, twice in a row.
        named: time in s for which its name may still change; then the next change is looked for, with what is learned anew.
        force_noise: white noise of the axial forces in N over a block.
        force_drift, force_time: slow forces in N, and the time in s over which they fade.
        point_drift, point_time: slow biases of the points in m, likewise.
        place_force, place_points: what comes back at a place, in N and in m; places are `place_size` in m apart, and a speed counts as the
            way of `place_time` in s; `again_force` differs from visit to visit in N.
        pressure_noise, pressure_late: of the rise of a pressure over a block in Pa, and a part of what it should be.
        tension_noise, tension_late: of a dynamometer over a block in N, and a time in s that motors may be early or late.
        least_noise: variance that is left at least, over what is assumed.
    """

    begins: float = 0.5
    learns: float = 14.0
    every: float = 1.5
    marks: int = 14
    evidence: float = 17.0
    named: float = 8.0
    force_noise: float = 0.07
    force_drift: float = 0.1
    force_time: float = 0.6
    point_drift: float = 0.8e-4
    point_time: float = 4.0
    place_force: float = 0.2
    again_force: float = 0.1
    place_points: float = 0.6e-4
    place_size: float = 0.02
    place_time: float = 0.2
    pressure_noise: float = 300.0
    pressure_late: float = 0.15
    tension_noise: float = 4e-3
    tension_late: float = 3e-3
    least_noise: float = 0.3


DEFAULT = MonitorSettings()
REGULATORS = np.array([8.0, 8.0, 4e4, 0.3])  # spreads of 1 / time constants in 1/s, of a zero and a leak over a time constant
MOTORS = np.array([0.3, 0.02])  # N, s


@dataclass(frozen=True)
class Changed:
    """A change of the machine.

    Attributes:
        told: when it was told first, in s of the run.
        since: when it began, about.
        evidence: logarithm of the odds for a change.
        probabilities: of the causes that explain it, the likeliest first.
        sentences: about these causes, in the same order.
    """

    told: float
    since: float
    evidence: float
    probabilities: Mapping[str, float]
    sentences: tuple[str, ...]

    def __str__(self) -> str:
        parts = [f"{text} ({100 * part:.0f} %)" for text, part in zip(self.sentences, self.probabilities.values(), strict=True)]
        return f"since about {self.since:.0f} s the machine is not what it was when the run began: {', or '.join(parts)}"


class Monitor:
    """The watch on one loop.

    Args:
        model: the controller's.
        reference: that the loop follows by its time.
        first: the command under which the robot rests at the start.
        settings: of the monitor.

    Attributes:
        changes: that were told.
        evidence: for a change now, as a logarithm of odds; 0 while it learns.
    """

    def __init__(self, model: CompiledModel, reference: Reference, first: Command, settings: MonitorSettings = DEFAULT) -> None:
        self.settings, self._reference = settings, reference
        self._signatures = FaultRegressors(model, reference, first)
        layout, tracker = model.layout, model.robot.tracker
        self._causes = causes(layout.actuator_names, layout.point_names, self._signatures.body)
        columns = {BODY: len(self._signatures.spreads), REGULATOR: len(REGULATORS), MOTOR: len(MOTORS)}
        self._weighed = FaultHypothesisTest(self._causes, columns)
        self._count, self._coordinates = len(first.tensions), 3 * layout.points
        self._white = ((tracker.noise_rms_m if tracker else 1e-3) ** 2 / 3 / BLOCK) * np.eye(self._coordinates)
        self._places, self._at, self._new = np.zeros((0, 6)), -1, True
        self._zero: float | None = None
        self.changes: list[Changed] = []
        self.evidence = 0.0
        self._restart(0.0)

    def __repr__(self) -> str:
        return f"Monitor({len(self._causes)} causes, evidence={self.evidence:.3g}, changes={len(self.changes)})"

    def _restart(self, now: float) -> None:
        """Learn anew from a time in s of the run."""
        settings, count, spreads = self.settings, self._count, self._signatures.spreads
        slow = np.repeat([settings.force_drift, settings.point_drift], [count, self._coordinates])
        times = np.repeat([settings.force_time, settings.point_time], [count, self._coordinates])
        self._coloured = PrewhiteningFilter(slow, times, self._coordinates, 1 + len(spreads), BLOCK * self._reference.period)
        kinds = ((BODY, spreads, 1), (REGULATOR, REGULATORS, count), (MOTOR, MOTORS, count))
        self._sums = {name: Sums(of, machines, settings.marks, settings.least_noise) for name, of, machines in kinds}
        self._times: list[float] = []
        self._learned, self._next = now + settings.learns, now + settings.learns
        self._suspected, self._open, self.evidence = False, False, 0.0

    def add(self, sample: Sample, command: Command) -> None:
        """Take a sample and what was commanded for it."""
        self._zero = sample.time if self._zero is None else self._zero
        now, period = sample.time - self._zero, self._reference.period
        rows = self._signatures.add(sample, command, round(now / period))
        if rows is None or now < self.settings.begins:
            return
        self._take(rows)
        if now >= self._next:
            if self._times:
                self._look(now)
            if now >= self._learned:
                self._times = [*self._times, now][-self.settings.marks :]
                for sums in self._sums.values():
                    sums.mark()
            self._next = max(self._next + self.settings.every, now)

    def describe_changes(self) -> dict[str, str]:
        """Sentence for every change, by its key in the log."""
        return {ABOUT if not k else f"{ABOUT}, change {k + 1}": str(change) for k, change in enumerate(self.changes)}

    def _take(self, rows: Rows) -> None:
        settings, outputs = self.settings, self._coordinates
        pulled = rows.gain @ rows.gain.T
        white = self._white + settings.force_noise**2 * pulled
        own = settings.place_force**2 * pulled + settings.place_points**2 * np.eye(outputs)
        seen = np.hstack([rows.gain, np.eye(outputs)])
        place, learning = self._place(rows.place), not self._times
        whitened = self._coloured.whiten(rows.points, seen, white, place, own, settings.again_force**2 * pulled)
        if learning or not self._new:
            self._sums[BODY].add(whitened[None])
        if (rise := rows.pressures) is not None:
            late = settings.pressure_late * np.abs(rise[:, 1] + rise[:, 2])
            self._sums[REGULATOR].add((rise / np.hypot(settings.pressure_noise, late)[:, None])[:, None])
        if (beside := rows.tensions) is not None:
            self._sums[MOTOR].add((beside / np.hypot(settings.tension_noise, settings.tension_late * beside[:, 2])[:, None])[:, None])

    def _place(self, place: np.ndarray) -> int:
        """Number of a place, a new one where none is near; it is new until it is left."""
        scaled = place * np.repeat([1.0, self.settings.place_time], 3)
        apart = np.linalg.norm(self._places - scaled, axis=1)
        known = len(apart) > 0 and bool(apart.min() <= self.settings.place_size)
        number = int(np.argmin(apart)) if known else len(apart)
        if not known:
            self._places = np.vstack([self._places, scaled])
        if number != self._at:
            self._at, self._new = number, not known
        return number

    def _look(self, now: float) -> None:
        """Whether something changed, by a time in s of the run."""
        left: dict[str, GlrStatistics] = {name: sums.score_changes() for name, sums in self._sums.items()}
        found, sizes = self._weighed.evidence(left)
        each = np.logaddexp.reduce(found, axis=0) - np.log(len(self._times))
        self.evidence = float(np.logaddexp.reduce(each))
        beyond = self.evidence > self.settings.evidence
        if beyond and (self._suspected or self._open):
            changed = self._explain_change(now, self._temper(each, found, left), found, sizes)
            if self._open:
                self.changes[-1] = replace(changed, told=self.changes[-1].told)
            else:
                self.changes.append(changed)
            self._open = True
        self._suspected = beyond
        if self._open and now > self.changes[-1].told + self.settings.named:
            self._restart(now)

    def _temper(self, each: np.ndarray, found: np.ndarray, left: Mapping[str, GlrStatistics]) -> np.ndarray:
        """Evidence of each cause where the noise is what the likeliest one leaves: t instead of normal errors.

        A change that is much larger than the noise is never explained to the noise, and what is left would decide between causes alike.
        """
        best = int(each.argmax())
        of, mark = self._causes[best], int(found[:, best].argmax())
        rows, misfit = self._sums[of.regression].measure_misfit(mark, of.machine, each[best], left[of.regression].noise)
        return -0.5 * rows * np.log1p(2 * (each[best] - each) / max(misfit, rows))

    def _explain_change(self, now: float, each: np.ndarray, found: np.ndarray, sizes: np.ndarray) -> Changed:
        parts = np.exp(each - np.logaddexp.reduce(each))
        order = [k for k in np.argsort(-parts)[:3] if parts[k] > 0.01]
        since = found.argmax(axis=0)
        names = {self._causes[k].about: float(parts[k]) for k in order}
        sentences = tuple(self._causes[k].describe(float(sizes[since[k], k])) for k in order)
        return Changed(now, self._times[since[order[0]]], self.evidence, names, sentences)


class Watched:
    """A controller with a monitor beside it; what the monitor does is done once a command is sent.

    Args:
        controller: any; its commands stay what they are.
        monitor: that watches it.
    """

    def __init__(self, controller: Controller, monitor: Monitor) -> None:
        self.controller, self.monitor = controller, monitor
        self._fresh: tuple[Sample, Command] | None = None

    @property
    def reference(self) -> Reference:
        """The controller's."""
        return self.controller.reference

    def start(self) -> Command:
        """See `Controller`."""
        return self.controller.start()

    def command(self, sample: Sample) -> Command:
        """See `Controller`."""
        self._watch()
        command = self.controller.command(sample)
        self._fresh = sample, command
        return command

    def prepare(self) -> None:
        """See `Prepares`; then the monitor takes the last sample."""
        if isinstance(self.controller, Prepares):
            self.controller.prepare()
        self._watch()

    def telemetry(self) -> Telemetry:
        """The controller's, with what the monitor says."""
        told, monitor = self.controller.telemetry(), self.monitor
        return replace(told, columns={**told.columns, EVIDENCE: monitor.evidence}, doubts={**told.doubts, **monitor.describe_changes()})

    def _watch(self) -> None:
        if self._fresh is not None:
            self.monitor.add(*self._fresh)
            self._fresh = None


def attach_monitor(controller: Controller, model: CompiledModel, settings: MonitorSettings = DEFAULT) -> Controller:
    """Attach a monitor to a controller; not where its reference does not go by time alone or the arm is guided."""
    reference = controller.reference
    if type(reference) is not Reference or model.layout.guided:
        return controller
    return Watched(controller, Monitor(model, reference, controller.start(), settings))

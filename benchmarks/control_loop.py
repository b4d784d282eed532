"""The whole controller at work: its step on recorded samples, and whether it keeps its period beside the simulated rig."""

from __future__ import annotations

import numpy as np

from benchmarks.goals import Goal, times_real
from benchmarks.parts import Session
from benchmarks.timing import Contender, Task
from tepm_opt.control.loop import LoopRecord, close_loop
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.control.references.reference import Reference, approach, reference_of, sample_tips
from tepm_opt.hw.rig import Sample
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.planning.trajectories import circle

RECORDED = 600  # samples
LAP = 8.0  # s, of the circle
APPROACH = 3.0  # s, from rest to where the circle begins
CLOSE = 5e-3  # m, largest root mean square error of the tip on the circle
LOOP = "tepm_opt close_loop, MPC on the virtual prototype"


def circle_with_approach(model: CompiledModel, laps: float) -> Reference:
    """Laps of the circle, from rest."""
    tips, counted = sample_tips(circle(400), laps=laps)
    lead = approach(model, tips[0], APPROACH)
    return reference_of(model, np.vstack([lead, tips]), np.concatenate([np.zeros(len(lead), dtype=bool), counted]))


class RecordedLoop:
    """A controller on samples of the circle that were recorded in closed loop, again and again from the start."""

    def __init__(self, model: CompiledModel) -> None:
        self._model, self._reference = model, circle_with_approach(model, 1.0)
        self._samples: list[Sample] = []
        rig, self._controller = SimulatedRig(), Mpc(model, self._reference)
        rig.apply(self._controller.start())
        for _ in range(RECORDED):
            self._samples.append(rig.read())
            rig.apply(self._controller.command(self._samples[-1]))
        self._next = RECORDED

    @property
    def is_c(self) -> bool:
        """Whether the controller steps in C."""
        return self._controller.is_c

    def prepare(self) -> None:
        """Prepare for the next sample; at the end of the recording with a new controller."""
        if self._next == RECORDED:
            self._controller, self._next = Mpc(self._model, self._reference), 0
        self._controller.prepare()

    def feedback(self) -> None:
        """From a sample to the command, prepared."""
        self._controller.command(self._samples[self._next])
        self._next += 1

    def whole(self) -> None:
        """Feedback, what is logged, and preparation for the next sample."""
        self.feedback()
        self._controller.telemetry()
        if self._next < RECORDED:
            self._controller.prepare()

    def begin(self) -> None:
        """Let the next step not be the first of a recording, which takes longer."""
        if self._next == RECORDED:
            self.prepare()
            self.whole()


def tasks(session: Session) -> list[Task]:
    """One lap of the circle in closed loop, from rest; the answer is the tip's error."""
    model, figures = session.scene.model, {}
    reference = circle_with_approach(model, 1.0)

    def judged(done: LoopRecord) -> np.ndarray:
        figures["late"] = float((np.array(done.seconds) > reference.period).mean())
        return np.array([done.error()])

    whole = Contender(LOOP, lambda: close_loop(SimulatedRig(), Mpc(model, reference), model.robot), judged, ours=True)
    title = f"A lap of the circle in closed loop, {LAP:g} s and {APPROACH:g} s to its start"
    return [Task("loop", title, np.zeros(1), [whole], CLOSE, LAP + APPROACH, figures)]


GOALS = (
    times_real("loop", "closed loop of 8 s with MPC, times real time", 2, "at least twice real time, controller and rig on one core"),
    Goal(
        "loop", "closed loop, controller's steps beyond 10 ms", "all but 1 % of the controller's steps within 10 ms",
        lambda task, _: task.figures.get("late", np.nan), 0.01,
    ),
)  # fmt: skip

"""The closed loop live on a simulated rig, with a button that disturbs it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from tepm_opt.control.controllers import DEFAULT, controllers
from tepm_opt.errors import InputError
from tepm_opt.hw.guard import Stopped
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.jobs.closed_loop import ClosedLoop
from tepm_opt.jobs.course import Course
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.numerics.text import quantity
from tepm_opt.solvers.planning.scaled_paths import path_for
from tepm_opt.solvers.planning.trajectories import SHAPES
from tepm_opt.studio.loop import LiveLoop, Moment
from tepm_opt.studio.moments import MomentNode, Trace, describe_moment
from tepm_opt.studio.shapes import MEASURED
from tepm_opt.studio.worker import Worker, asks

if TYPE_CHECKING:
    import viser

DIRECTIONS = {f"{sign}{axis}": float(f"{sign}1") * np.eye(3)[k] for k, axis in enumerate("xyz") for sign in "+-"}
PLOTTED = 0.2  # s between updates of the plot


class LoopView:
    """A closed loop on a simulated rig.

    Args:
        server: viser's.
        worker: that draws; the loop has a thread of its own.
        model: the controller's.
        rig: opens the rig for each loop.

    Attributes:
        loop: that runs; None where none does.
        done: what the last one did.
    """

    name = "closed loop"

    def __init__(self, server: viser.ViserServer, worker: Worker, model: CompiledModel, rig: Callable[[], SimulatedRig]) -> None:
        self._server, self._worker, self._model, self._open = server, worker, model, rig
        self._node = MomentNode(server.scene, model.robot, model.input_max)
        self._trace, self._plotted, self._on = Trace(), 0.0, False
        self._thread: threading.Thread | None = None
        self.loop: LiveLoop | None = None
        self.done: ClosedLoop | None = None
        self._controls(server.gui)

    def enter(self) -> None:
        """Come into sight, with the arm at rest until a loop moves it."""
        self._on = self._folder.visible = True
        self._worker.ask("rest", self._rest)

    def leave(self) -> None:
        """Stop the loop and go out of sight."""
        self._on = self._folder.visible = False
        self.close()
        self._node.hide()

    def _rest(self) -> None:
        if self._on and self.loop is None:
            self._node.rest(self._model)

    def close(self) -> None:
        """Stop the loop that runs."""
        if (loop := self.loop) is not None:
            loop.stop()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout=10.0)

    def _controls(self, gui: viser.GuiApi) -> None:
        """Everything in the panel."""
        kinds = tuple(kind.name for kind in controllers())
        self._folder = gui.add_folder("closed loop on the simulated rig", visible=False)
        with self._folder:
            self._path = gui.add_dropdown("path", tuple(SHAPES), initial_value=next(iter(SHAPES)))
            self._controller = gui.add_dropdown("controller", kinds, initial_value=DEFAULT)
            self._laps = gui.add_number("laps of a closed path", 3, min=1, max=100, step=1)
            self._button = gui.add_button("start")
            with gui.add_folder("disturbance"):
                self._direction = gui.add_dropdown("direction", tuple(DIRECTIONS), initial_value="+x")
                self._newtons = gui.add_slider("force, N", 0.05, 2.0, 0.05, 0.2)
                self._seconds = gui.add_slider("duration, s", 0.1, 5.0, 0.1, 1.0)
                self._push = gui.add_button("push the tip", disabled=True)
            self._words = gui.add_markdown("The rig is simulated, always: this page has no way to a real one.")
            self._plot = gui.add_uplot(
                (np.zeros(1), np.zeros(1)),
                ({"label": "s"}, {"label": "tip off its target, mm", "stroke": "rgb({}, {}, {})".format(*MEASURED), "width": 2}),
                scales={"x": {"time": False}, "y": {"auto": True}}, legend={"live": False}, padding=(14, 14, 0, 0), aspect=1.6,
                visible=False,
            )  # fmt: skip
        self._button.on_click(asks(self._worker, "start or stop", self._start_or_stop))
        self._push.on_click(lambda event: self._disturb())

    def _start_or_stop(self) -> None:
        if self.loop is not None:
            self.loop.stop()
            return
        try:
            self.loop = LiveLoop(self._model, self._open(), self._show_moment)
        except InputError as error:
            self._words.content = f"✗ {error}"
            return
        self._button.label = "stop"
        self._words.content = "preparing …"
        self._thread = threading.Thread(target=self._run, args=(self.loop,), name="closed loop", daemon=True)
        self._thread.start()

    def _run(self, loop: LiveLoop) -> None:
        """The loop, in a thread of its own, and how it ended in words."""
        try:
            trajectory = path_for(self._model, self._path.value)
            course = Course(laps=float(self._laps.value) if trajectory.closed else 1.0)
            self.done = loop.run(trajectory, course, self._controller.value, self._show_preparation)
            said = describe_ending(self.done)
        except Stopped as stop:
            said = str(stop)
        except (InputError, RuntimeError, OSError) as error:
            said = f"✗ {error}"
        self.loop = None
        self._worker.ask("loop ended", lambda: self._show_ending(said))

    def _show_preparation(self, stage: str, done: float, of: float) -> None:
        if stage != "tracking":
            self._worker.ask("stage", lambda: setattr(self._words, "content", f"{stage}: {done:.0f} of {of:.0f}"))

    def _show_ending(self, said: str) -> None:
        self._words.content = said
        self._button.label, self._push.disabled = "start", True

    def _disturb(self) -> None:
        if (loop := self.loop) is not None:
            loop.push(float(self._newtons.value) * DIRECTIONS[self._direction.value], float(self._seconds.value))

    def _show_moment(self, moment: Moment) -> None:
        """Show a moment that the loop's thread reports."""
        self._trace.add(moment)
        self._worker.ask("moment", lambda: self._draw(moment))

    def _draw(self, moment: Moment) -> None:
        if not self._on or self.loop is None:
            return
        self._push.disabled = False
        path = self._trace.path
        with self._server.atomic():
            self._node.show(moment, path)
            self._words.content = describe_moment(moment, path)
            if (now := time.monotonic()) - self._plotted > PLOTTED:
                self._plotted, self._plot.visible = now, True
                self._plot.data = (path.time, 1e3 * np.nan_to_num(path.errors))


def describe_ending(done: ClosedLoop) -> str:
    """Describe the end of a loop as Markdown."""
    rms = done.rms(True)
    errors = f": true tip **{quantity(rms, 'm')}** rms where the path counts" if np.isfinite(rms) else ""
    doubts = "".join(f"\n\n▲ from {since:.1f} s: {text}" for since, text in done.doubts.values())
    return f"**{done.outcome}** after {done.time[-1] if len(done.time) else 0:.1f} s{errors}{doubts}"

"""The studio's page: an arm to drag, recordings to watch, a closed loop to disturb. One of them is in sight at a time."""

from __future__ import annotations

from types import TracebackType
from typing import Protocol

from tepm_opt.models.compile import CompiledModel
from tepm_opt.studio.arm_view import ArmView
from tepm_opt.studio.film_view import FilmView
from tepm_opt.studio.loop import SIM, simulated_rig
from tepm_opt.studio.loop_view import LoopView
from tepm_opt.studio.recordings import Recordings
from tepm_opt.studio.scene import prepare
from tepm_opt.studio.server import start, stop
from tepm_opt.studio.worker import Worker, asks


class View(Protocol):
    """View of the studio, one of which is in sight at a time."""

    name: str

    def enter(self) -> None:
        """Come into sight."""

    def leave(self) -> None:
        """Go out of sight."""


class Studio:
    """The page, served until it is closed.

    Args:
        model: compiled model of the arm.
        recordings: to watch; none where absent.
        rig: of the closed loop: "sim" or "sim:FILE".
        port: to listen at, or the next free one above it; any where 0.

    Attributes:
        address: to open in a browser, once.
        arm, film, loop: its views; `film` is None without recordings.

    Raises:
        InputError: viser is not installed, or the rig is not a simulated one.
    """

    def __init__(self, model: CompiledModel, recordings: Recordings | None = None, rig: str = SIM, port: int = 0) -> None:
        simulated_rig(rig)  # refused now, not when somebody presses "start"
        self._server, gate = start(f"tepm studio · {model.robot.name}", port)
        self.address = gate.address
        prepare(self._server, model.robot)
        self.worker, self.slow = Worker(self._show_failure), Worker(self._show_failure)
        self._message = self._server.gui.add_markdown("", visible=False)
        names = [ArmView.name, LoopView.name]
        names = names if recordings is None else [FilmView.name, *names]
        self._choice = self._server.gui.add_dropdown("show", names, initial_value=names[0])
        self.arm = ArmView(self._server, self.worker, self.slow, model)
        self.film = None if recordings is None else FilmView(self._server, self.worker, recordings, model)
        self.loop = LoopView(self._server, self.worker, model, lambda: simulated_rig(rig, robot=model.robot))
        views: list[View] = [self.arm, self.loop, *([] if self.film is None else [self.film])]
        self._views = {view.name: view for view in views}
        self._choice.on_update(asks(self.worker, "view", lambda: self._show(self._views[self._choice.value])))
        self._shown = self._views[names[0]]
        self._shown.enter()

    def show(self, name: str) -> None:
        """Have a view come into sight in place of the one that is.

        Raises:
            KeyError: no such view.
        """
        view = self._views[name]
        self.worker.ask("view", lambda: self._show(view))

    def _show(self, view: View) -> None:
        if view is not self._shown:
            self._shown.leave()
            self._shown = view
            view.enter()
            self._choice.value = view.name

    def settle(self) -> bool:
        """Wait until all that was asked for is drawn; whether it was."""
        return self.worker.settle() and self.slow.settle(60.0)

    def close(self) -> None:
        """End the page, and the loop that runs."""
        self.loop.close()
        self.slow.close()
        self.worker.close()
        stop(self._server)

    def __enter__(self) -> Studio:
        """The page itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """End the page."""
        self.close()

    def _show_failure(self, error: Exception) -> None:
        """Show on the page in words why a task failed."""
        self._message.visible = True
        self._message.content = f"✗ {' '.join(str(error).split()) or type(error).__name__}"

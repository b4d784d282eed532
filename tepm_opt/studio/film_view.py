"""The film of a log beside its model: what was measured, what the model makes of the same inputs, and the arrows between them."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from tepm_opt.errors import InputError
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.layout import Layout
from tepm_opt.solvers.kinematics.backbone import backbone
from tepm_opt.solvers.numerics.text import quantity
from tepm_opt.studio.recordings import Film, Recordings, film
from tepm_opt.studio.scene import ArmNode, line_node, set_lines
from tepm_opt.studio.shapes import GAP, MEASURED, TARGET, polyline
from tepm_opt.studio.worker import Worker, asks

if TYPE_CHECKING:
    import viser

SPEEDS = ("0.25", "0.5", "1", "2", "5", "10")
ROWS_A_SECOND = 2.0  # of equilibria, that have no time


class FilmView:
    """Recorded runs.

    Args:
        server: viser's.
        worker: that simulates and draws.
        recordings: what there is to see.
        known: compiled models that may be among its.

    Attributes:
        film: that is shown; None before the first one is ready.
    """

    name = "recording"

    def __init__(self, server: viser.ViserServer, worker: Worker, recordings: Recordings, *known: CompiledModel) -> None:
        self._server, self._worker, self._recordings = server, worker, recordings
        robot = next(iter(recordings.models.values())).robot
        self._base, size = np.array(robot.mount.base_position_m), robot.parameters.r / 0.04
        self._arm = ArmNode(server.scene, "modelled", Layout.from_robot(robot), robot.parameters.r)
        self._measured = line_node(server.scene, "/measured/backbone", 0.005 * size, MEASURED)
        self._points = server.scene.add_point_cloud(
            "/measured/points", np.zeros((1, 3)), MEASURED, point_size=0.007 * size, point_shape="circle", precision="float32",
            visible=False,
        )  # fmt: skip
        self._target = server.scene.add_icosphere("/measured/target", 0.009 * size, TARGET, visible=False)
        self._arrows = server.scene.add_arrows(
            "/residuals", np.zeros((1, 2, 3)), GAP, shaft_radius=0.0035 * size, head_radius=0.009 * size, head_length=0.015 * size,
            visible=False,
        )  # fmt: skip
        self._models = {name: one for name, model in recordings.models.items() for one in known if one.model == model}
        self._films: dict[tuple[str, str], Film] = {}
        self.film: Film | None = None
        self._on, self._playing, self._since = False, False, 0.0
        self._controls(server.gui)

    def enter(self) -> None:
        """Come into sight."""
        self._on = self._folder.visible = True
        self._worker.ask("film", self._load)

    def leave(self) -> None:
        """Stop and go out of sight."""
        self._on = self._folder.visible = self._playing = False
        self._button.label = "play"
        self._arm.hide()
        for handle in (self._measured, self._points, self._target, self._arrows):
            handle.visible = False

    def _controls(self, gui: viser.GuiApi) -> None:
        """Everything in the panel."""
        runs, models = tuple(run.file for run in self._recordings.runs), tuple(self._recordings.models)
        self._folder = gui.add_folder("recording", visible=False)
        with self._folder:
            self._run = gui.add_dropdown("run", runs, initial_value=runs[0])
            self._model = gui.add_dropdown("beside", models, initial_value=models[0], visible=len(models) > 1)
            self._button = gui.add_button("play")
            self._time = gui.add_slider("time, s", 0.0, 1.0, 0.01, 0.0)
            self._speed = gui.add_dropdown("speed", SPEEDS, initial_value="1")
            self._magnified = gui.add_slider("arrows × ", 1, 50, 1, 1, hint="arrows from the model to what was measured")
            self._words = gui.add_markdown("simulating …")
        for choice in (self._run, self._model):
            choice.on_update(asks(self._worker, "film", self._load))
        self._time.on_update(asks(self._worker, "frame", self._draw))
        self._magnified.on_update(asks(self._worker, "frame", self._draw))
        self._button.on_click(asks(self._worker, "play", self._toggle))

    def _load(self) -> None:
        """Make the film that is chosen, and show it from its beginning."""
        if not self._on:
            return
        chosen = self._model.value, self._run.value
        if chosen not in self._films:
            self._words.content = "simulating …"
            if chosen[0] not in self._models:
                self._models[chosen[0]] = compile_model(self._recordings.models[chosen[0]])
            run = next(run for run in self._recordings.runs if run.file == chosen[1])
            try:
                self._films[chosen] = film(self._models[chosen[0]], run, self._recordings.static)
            except InputError as error:
                self._words.content = f"✗ {error}"
                return
        same = self.film is not None and self.film.run is self._films[chosen].run
        self.film = self._films[chosen]
        self._time.max = max(float(self.film.time[-1]), 0.01)
        if not same:
            self._time.value = 0.0
        self._draw()

    def _toggle(self) -> None:
        if self.film is None:
            return
        self._playing = not self._playing
        self._button.label = "pause" if self._playing else "play"
        if self._playing:
            if self._time.value >= self._time.max:
                self._time.value = 0.0
            self._since = time.monotonic()
            self._worker.ask("play on", self._play)

    def _play(self) -> None:
        """The next frame, and so on until the end."""
        if not (self._playing and self._on):
            return
        now = time.monotonic()
        passed, self._since = (now - self._since) * float(self._speed.value), now
        if self._recordings.static:
            passed *= ROWS_A_SECOND
        self._time.value = min(float(self._time.value) + passed, float(self._time.max))
        self._draw()
        if self._time.value < self._time.max:
            self._worker.ask("play on", self._play)
        else:
            self._toggle()

    def _draw(self) -> None:
        if not self._on or self.film is None:
            return
        shown, row = self.film, self.film.row(float(self._time.value))
        measured = shown.run.points[row]
        seen = np.isfinite(measured).all(axis=1)
        with self._server.atomic():
            self._arm.show(shown.nodes[row], shown.scale_inputs(row))
            self._points.visible = bool(seen.any())
            if seen.any():
                self._points.points = measured[seen].astype(np.float32)
            self._measured.visible = bool(seen.all())
            if seen.all():
                set_lines(self._measured, polyline(backbone(self._base, measured)))
            arrows = shown.arrows(row, float(self._magnified.value))
            self._arrows.visible = len(arrows) > 0
            if len(arrows):
                self._arrows.points = arrows.astype(np.float32)
            target = shown.column("target", row)
            self._target.visible = target is not None
            if target is not None:
                self._target.position = target
            self._words.content = describe_row(shown, row, self._recordings.verdict)


def describe_row(film: Film, row: int, verdict: str) -> str:
    """Describe a row of a film as Markdown.

    Args:
        film: of which.
        row: of the run.
        verdict: what a verdict says of the data; may be empty.
    """
    layout, rms = film.model.layout, film.rms()
    gaps = np.linalg.norm(film.run.points[row] - film.points[row], axis=1)
    at = f"row {row + 1} of {len(film.time)}" + (f", {film.time[row]:.2f} s" if np.isfinite(film.run.time).all() else "")
    head = f"{at}. Green: measured; purple arrows: from the model to it.\n\n| | now | rms of the run |\n|:---|---:|---:|\n"

    def cell(value: float) -> str:
        return quantity(float(value), "m") if np.isfinite(value) else "–"

    rows = [f"| {name} | {cell(now)} | {cell(all_)} |" for name, now, all_ in zip(layout.point_names, gaps, rms, strict=True)]
    parts = [head + "\n".join(rows)]
    if film.message:
        parts.append(f"▲ the model has no motion to the end: {film.message}")
    return "\n\n".join([*parts, *([verdict] if verdict else [])])

"""The arm that a person drags and sets: gizmo, sliders, ellipsoids, workspace, words."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.studio.arm import KINDS, MODE, drag_tip, off_grid, set_inputs
from tepm_opt.studio.scene import Bench, line_node, set_lines
from tepm_opt.studio.words import describe_operating_point
from tepm_opt.studio.worker import Worker, asks
from tepm_opt.studio.workspace import Boundary, boundary

if TYPE_CHECKING:
    import viser

SHARE = 10  # % of the inputs' ranges that ellipsoids begin with
READABLE = 0.1  # s between updates of words and sliders: nobody reads 60 a second
STEPS = 1000  # of a slider
HELP = "Drag the arrows at the tip, or move the sliders."


class ArmView:
    """The arm under inputs.

    Args:
        server: viser's.
        worker: that solves and draws.
        slow: another one, for what takes seconds.
        model: compiled model.

    Attributes:
        point: the operating point that is shown.
    """

    name = "arm"

    def __init__(self, server: viser.ViserServer, worker: Worker, slow: Worker, model: CompiledModel) -> None:
        self._server, self._worker, self._slow, self._model = server, worker, slow, model
        self._scales = np.repeat([1e-3, 1.0], model.layout.inputs // 2)  # kPa and N on the sliders
        self._bench = Bench(server.scene, model.layout, model.values["r"])
        self._dome = line_node(server.scene, "/workspace", 0.0012 * model.values["r"] / 0.04)
        self._boundaries: dict[ActuationMode, Boundary] = {}
        self._told, self._following, self._on = -np.inf, False, False
        self.point = set_inputs(model, np.zeros(model.layout.inputs))
        self._gizmo = server.scene.add_transform_controls(
            "/tip", scale=0.2 * model.robot.modules * model.values["L_0"], disable_rotations=True, depth_test=False,
            position=self.point.held.tip, visible=False,
        )  # fmt: skip
        self._gizmo.on_update(self._follow_drag)
        self._controls(server.gui)

    def enter(self) -> None:
        """Come into sight."""
        self._on = self._folder.visible = self._gizmo.visible = True
        self._worker.ask("look", self._draw)
        self._worker.ask("tell", self._tell)
        self._slow.ask("workspace", self._draw_workspace)

    def leave(self) -> None:
        """Go out of sight."""
        self._on = self._folder.visible = self._gizmo.visible = self._dome.visible = False
        self._bench.hide()

    def drag(self, target: np.ndarray) -> None:
        """Bring the tip, and the gizmo, to a target in G, (3,) in m."""
        self._gizmo.position = target
        self._seek(target)

    def set(self, inputs: np.ndarray) -> None:
        """Set inputs, (2 · modules · actuators,) in Pa and N."""
        self.point = set_inputs(self._model, inputs, self.point)
        self._gizmo.position = self.point.held.tip
        self._draw()
        self._tell()

    @property
    def _mode(self) -> ActuationMode:
        return ActuationMode(self._mode_choice.value)

    def _controls(self, gui: viser.GuiApi) -> None:
        """Everything in the panel."""
        layout = self._model.layout
        self._folder = gui.add_folder("arm", visible=False)
        with self._folder:
            gui.add_markdown(HELP)
            self._words = gui.add_markdown("")
            modes = tuple(mode.value for mode in ActuationMode)
            self._mode_choice = gui.add_dropdown("dragged with", modes, initial_value=MODE.value, hint="how axial forces are made")
            self._shown = {
                kind: gui.add_checkbox(f"{kind} ellipsoid", True, hint="how far the tip goes when inputs change, to first order")
                for kind in KINDS
            }
            self._share = gui.add_slider("% of range", 1, 50, 1, SHARE, hint="change of inputs that the ellipsoids are for")
            self._reach = gui.add_checkbox("workspace", False, hint="outer boundary of what the tip reaches with equal curvature")
            self._progress = gui.add_progress_bar(0.0, visible=False)
            zero = gui.add_button("all inputs to zero")
            placed = [pair for module in range(layout.modules) for pair in self._module(gui, module)]
        self._sliders = [slider for _, slider in sorted(placed, key=lambda pair: pair[0])]
        for slider in self._sliders:
            slider.on_update(self._slid)
        for handle in (*self._shown.values(), self._share):
            handle.on_update(asks(self._worker, "look", self._draw))
        self._reach.on_update(asks(self._slow, "workspace", self._draw_workspace))
        self._mode_choice.on_update(asks(self._worker, "arm", self._again))
        zero.on_click(asks(self._worker, "arm", self._to_zero))

    def _module(self, gui: viser.GuiApi, module: int) -> list[tuple[int, viser.GuiSliderHandle[float]]]:
        """The sliders of a module, each with its input's place in u."""
        layout, found = self._model.layout, []
        with gui.add_folder(f"module {module + 1}: pressures in kPa, tensions in N", expand_by_default=layout.modules < 4):
            for first, kind in ((0, "pressure"), (layout.inputs // 2, "tension")):
                for actuator in range(module * layout.actuators, (module + 1) * layout.actuators):
                    most = float((self._model.input_max * self._scales)[first + actuator])
                    whole, label = most or 1.0, f"{kind} {layout.actuator_names[actuator]}"
                    found.append((first + actuator, gui.add_slider(label, 0.0, whole, whole / STEPS, 0.0, disabled=most == 0)))
        return found

    def _follow_drag(self, event: viser.TransformControlsEvent) -> None:
        target = np.array(event.target.position, dtype=float)
        if self._on and event.client is not None:
            self._worker.ask("arm", lambda: self._seek(target))

    def _slid(self, event: viser.GuiEvent[viser.GuiSliderHandle[float]]) -> None:
        if event.client is not None:  # not when the sliders follow the tip
            self._worker.ask("arm", lambda: self.set(np.array([slider.value for slider in self._sliders]) / self._scales))

    def _seek(self, target: np.ndarray) -> None:
        self.point = drag_tip(self._model, target, self._mode, self.point)
        self._draw()
        self._tell(follow=True)

    def _again(self) -> None:
        if self._reach.value:
            self._slow.ask("workspace", self._draw_workspace)
        if self.point.asked is not None:
            self.drag(self.point.asked.target)

    def _to_zero(self) -> None:
        self.set(np.zeros(self._model.layout.inputs))
        self._tell(follow=True)

    def _tell(self, follow: bool = False) -> None:
        """Bring words, and sliders where they shall follow, up to date: not every frame, but the last one of a motion."""
        self._following |= follow
        if (now := time.monotonic()) - self._told < READABLE:
            self._worker.ask("tell", self._tell)
            return
        self._told = now
        with self._server.atomic():
            self._words.content = describe_operating_point(self.point, off_grid(self.point))
            if self._following:
                self._following = False
                for slider, value in zip(self._sliders, self.point.held.inputs * self._scales, strict=True):
                    slider.value = float(value)

    def _draw(self) -> None:
        if self._on:
            with self._server.atomic():
                self._bench.show(self.point, self._share.value / 100, [kind for kind in KINDS if self._shown[kind].value])

    def _draw_workspace(self) -> None:
        mode = self._mode
        if self._on and self._reach.value and mode not in self._boundaries:
            self._progress.visible = True
            try:
                self._boundaries[mode] = boundary(self._model, mode, progress=self._show_search_progress)
            except _Unwanted:
                pass
            finally:
                self._progress.visible = False
        if self._on and self._reach.value and mode in self._boundaries:
            set_lines(self._dome, self._boundaries[mode].pieces)
        else:
            self._dome.visible = False

    def _show_search_progress(self, stage: str, done: float, of: float) -> None:
        if not (self._on and self._reach.value):
            raise _Unwanted
        self._progress.value = 100 * done / of


class _Unwanted(Exception):  # noqa: N818  it says what happened
    """Nobody wants to see it any more."""

"""The page without a browser: what its controls do, as viser's callbacks would have it done."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="viser is not installed (extra view)")

from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.jobs.course import Course
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.robot import load_robot
from tepm_opt.studio import arm_view, loop_view, page
from tepm_opt.studio.live import LiveView
from tepm_opt.studio.loop import simulated_rig
from tepm_opt.studio.page import Studio
from tepm_opt.studio.recordings import Recordings, open_recordings
from tests.studio.recorded import bend, write
from tests.tools import variant


class Person:
    """An event of a control that a person has moved."""

    def __init__(self, target: Any = None) -> None:
        self.client, self.target = "somebody", target


def moved(handle: Any, value: Any) -> None:
    """Do what viser does where a person moves a control."""
    handle._impl.value = value
    for called in handle._impl.update_cb:
        called(Person(handle))


def pressed(handle: Any) -> None:
    """Do what viser does where a person presses a button."""
    for called in handle._impl.update_cb:
        called(Person(handle))


def waited(condition: Callable[[], bool], seconds: float = 20.0) -> bool:
    """Whether it came true in time."""
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)
    return condition()


@pytest.fixture(scope="module")
def studio(kang: CompiledModel, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studio]:
    recordings = open_recordings(write(tmp_path_factory.mktemp("recorded")))
    with Studio(kang, recordings, "sim:perfect") as opened:
        assert opened.settle()
        yield opened


def test_a_dragged_tip_takes_the_sliders_along(studio: Studio) -> None:
    studio.show("arm")
    assert studio.settle()
    target = np.array([0.1, 0.05, 0.34])
    studio.arm._gizmo._impl.position = target
    studio.arm._follow_drag(Person(studio.arm._gizmo))  # type: ignore[arg-type]
    assert studio.settle()
    np.testing.assert_allclose(studio.arm.point.held.tip, target, atol=1e-6)
    values = np.array([slider.value for slider in studio.arm._sliders]) / np.repeat([1e-3, 1.0], 6)
    np.testing.assert_allclose(values, studio.arm.point.held.inputs)
    assert "**reached**" in studio.arm._words.content
    drawn = studio.arm._bench._arm._muscles.points[-3:, 1].mean(axis=0)
    np.testing.assert_allclose(drawn, target, atol=1e-6)


def test_sliders_take_the_tip_along(studio: Studio) -> None:
    studio.show("arm")
    pressed_before = studio.arm.point
    moved(studio.arm._sliders[0], 100.0)
    assert studio.settle()
    assert studio.arm.point is not pressed_before
    assert studio.arm.point.held.inputs[0] == pytest.approx(1e5)
    np.testing.assert_allclose(studio.arm._gizmo.position, studio.arm.point.held.tip, atol=1e-6)
    moved(studio.arm._sliders[0], 500.0)
    assert studio.settle()
    label = studio.arm._bench._labels[0]
    assert (label.visible, label.text) == (True, "pressure 11 at its maximum")
    moved(studio.arm._mode_choice, "pressure")
    assert studio.settle()
    assert studio.arm.point.asked is None


def test_ellipsoids_can_be_left_out(studio: Studio) -> None:
    studio.show("arm")
    for shown in (False, True):
        moved(studio.arm._shown["tension"], shown)
        assert studio.settle()
        assert studio.arm._bench._ellipsoids["tension"].visible is shown


def test_the_workspace_is_sought_once(studio: Studio, monkeypatch: pytest.MonkeyPatch) -> None:
    sought: list[Any] = []

    def small(model: Any, mode: Any, progress: Any) -> Any:
        sought.append(mode)
        return whole(model, mode, around=3, polar=2, progress=progress)

    whole = arm_view.boundary
    monkeypatch.setattr(arm_view, "boundary", small)
    studio.show("arm")
    for shown in (True, False, True):
        moved(studio.arm._reach, shown)
        assert studio.settle()
        assert studio.arm._dome.visible is shown
    assert len(sought) == 1
    assert not studio.arm._progress.visible
    moved(studio.arm._reach, False)
    assert studio.settle()


def test_the_film(studio: Studio) -> None:
    """It plays to its end and stops; arrows are longer beside the model as it was known than beside the corrected one."""
    view = studio.film
    assert view is not None
    studio.show("recording")
    assert studio.settle()
    assert not studio.arm._gizmo.visible
    assert "payload" in view._words.content
    moved(view._time, 1.0)
    assert studio.settle()
    lengths = {}
    for model in ("nominal", "corrected"):
        moved(view._model, model)
        assert studio.settle()
        points = view._arrows.points
        lengths[model] = np.linalg.norm(points[:, 1] - points[:, 0], axis=1).max()
    assert lengths["corrected"] < 0.002 < lengths["nominal"]
    moved(view._speed, "10")
    pressed(view._button)
    assert waited(lambda: view._time.value == view._time.max and view._button.label == "play")
    moved(view._speed, "0.25")
    pressed(view._button)
    assert waited(lambda: view._button.label == "pause")
    studio.show("arm")
    assert studio.settle()
    assert not view._arrows.visible
    assert view._button.label == "play"


def test_a_run_beyond_the_limits_says_so(kang: CompiledModel) -> None:
    far = replace(bend(), inputs=bend().inputs + 1e6)
    with Studio(kang, Recordings("far", (far,), {"model": kang.model})) as opened:
        assert opened.settle()
        assert opened.film is not None
        assert "valid: 0 … 500000 Pa" in opened.film._words.content


def test_the_closed_loop(studio: Studio, monkeypatch: pytest.MonkeyPatch) -> None:
    """Started, pushed, stopped on the page; in virtual time as fast as it goes."""
    view = studio.loop
    monkeypatch.setattr(loop_view, "Course", lambda laps: Course(approach=0.2, pause=0.1, laps=laps))
    monkeypatch.setattr(view, "_open", lambda: simulated_rig("sim:perfect", wait=lambda seconds: time.sleep(0.002)))
    studio.show("closed loop")
    assert studio.settle()
    at_rest = view._node._arm._muscles
    assert at_rest.visible
    np.testing.assert_allclose(at_rest.points[-3:, 1, :2].mean(axis=0), 0.0, atol=1e-6)
    moved(view._controller, "mode1")
    assert view._push.disabled
    pressed(view._button)
    assert waited(lambda: "off its target" in view._words.content)
    assert (view._button.label, view._push.disabled) == ("stop", False)
    pressed(view._push)
    assert waited(lambda: "pushed with 0.2 N" in view._words.content)
    assert waited(lambda: view._plot.visible)
    pressed(view._button)
    assert waited(lambda: view.loop is None and view._button.label == "start")
    assert "interrupted" in view._words.content
    assert view.done is not None
    assert view.done.setup.controller == "mode1"


def test_a_loop_that_cannot_be_says_why(studio: Studio, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone() -> Any:
        raise InputError("the rig file is gone")

    monkeypatch.setattr(studio.loop, "_open", gone)
    studio.show("closed loop")
    pressed(studio.loop._button)
    assert waited(lambda: "the rig file is gone" in studio.loop._words.content)


def test_leaving_stops_the_loop(studio: Studio, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(studio.loop, "_open", lambda: simulated_rig("sim:perfect", wait=lambda seconds: time.sleep(0.002)))
    studio.show("closed loop")
    assert studio.settle()
    pressed(studio.loop._button)
    assert waited(lambda: studio.loop.loop is not None)
    studio.show("arm")
    assert waited(lambda: studio.loop.loop is None)
    assert studio.settle()


def test_what_fails_is_told(studio: Studio) -> None:
    def fail() -> None:
        raise RuntimeError("no\nluck")

    studio.worker.ask("anything", fail)
    assert studio.settle()
    assert (studio._message.visible, studio._message.content) == (True, "✗ no luck")


@pytest.mark.slow
def test_another_robot() -> None:
    """One module of four muscles, hanging: it is dragged, and the loop's rig and path are its own."""
    robot = variant(
        geometry={"modules": 1, "actuator_angles_deg": (0.0, 90.0, 180.0, 270.0), "segments_per_module": 3},
        mount={"base_rotation_deg": (180.0, 0.0, 0.0)},
    )
    with Studio(compile_model(robot, backend="python")) as opened:
        opened.arm.drag(np.array([0.03, 0.0, -0.24]))
        assert opened.settle()
        assert opened.arm.point.held.solved
        opened.show("closed loop")
        pressed(opened.loop._button)
        assert waited(lambda: "inverse kinematics" in opened.loop._words.content)


def test_wrong_rig_is_refused_before_anything_is_served(kang: CompiledModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "start", lambda *given: pytest.fail("it is served"))
    with pytest.raises(InputError, match="simulated rigs only"):
        Studio(kang, rig="serial:/dev/ttyACM0")


def test_the_live_view_has_nothing_to_press() -> None:
    """Whatever comes: true nodes or none, points that are lost."""
    robot = load_robot("kang2017")
    points = np.linspace([0, 0, 0.05], [0.05, 0.0, 0.35], 4)
    lost = points.copy()
    lost[1] = np.nan
    with LiveView(robot) as view:
        assert not view._server.gui._gui_input_handle_from_uuid
        for time_s, seen in ((0.0, points), (0.01, lost), (0.02, points)):
            view.show(Sample(time_s, seen), Command.from_inputs(np.zeros(12)), np.array([0.0, 0.0, 0.35]))
        assert view.settle()
        assert "tracked tip x 50.0" in view._words.content
        assert "off its target: **50.0 mm**" in view._words.content
        assert view._node._backbone.visible
        assert not view.wait_for_somebody(0.1)


def test_missing_viser_is_explained(kang: CompiledModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(InputError, match=r"pip install 'tepm-opt\[view\]'"):
        Studio(kang)


def test_files_stay_where_they_are(tmp_path: Path, kang: CompiledModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is written into a person's folder."""
    monkeypatch.chdir(tmp_path)
    with Studio(kang) as opened:
        assert opened.settle()
    assert list(tmp_path.iterdir()) == []

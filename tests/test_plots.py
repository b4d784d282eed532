"""What figures say of themselves: every panel has a title of its own, a legend tells what is what, no panel is squeezed into a stripe."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.jobs.gain import run_gain
from tepm_opt.jobs.ik import run_ik
from tepm_opt.models.compile import CompiledModel
from tepm_opt.plots.discrepancy import _label
from tepm_opt.plots.gain import gain_figure
from tepm_opt.plots.ik import ik_figure
from tepm_opt.plots.motion import _driven_axes
from tepm_opt.plots.plan import _way
from tepm_opt.solvers.planning.trajectories import circle
from tepm_opt.studies.paper.figures import _fig9
from tests.cli.conftest import thin_map


def titles(figure: Figure) -> list[str]:
    """Titles of all panels but scales of colours."""
    return [axes.get_title() for axes in figure.axes if axes.get_label() != "<colorbar>"]


def test_every_panel_of_the_inverse_kinematics_has_a_title(kang: CompiledModel) -> None:
    found = titles(ik_figure(run_ik(kang, circle(4))))
    assert len(found) == len(set(found)) == 4
    assert all(found)


def test_every_panel_of_the_gain_has_a_title_of_its_own(kang: CompiledModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """And no quarter is empty: there is a map of what pressures do beside that of tensions."""
    thin_map(monkeypatch)
    figure = gain_figure(run_gain(kang, SetPoints.single(np.full(12, 0.5)), with_map=True))
    found = titles(figure)
    assert len(found) == len(set(found)) == 6
    assert [word for word in ("10 to 20 %", "45 to 55 %", "pressures", "tensions") if not any(word in title for title in found)] == []


def test_a_plan_says_where_it_starts_and_ends() -> None:
    model = SimpleNamespace(layout=SimpleNamespace(point_names=("s1", "s2", "s3")))
    axes = Figure().subplots()
    _way(axes, SimpleNamespace(points=np.random.default_rng(0).normal(size=(5, 3, 3)), model=model), (), (0, 2))  # type: ignore[arg-type]
    lines = {str(line.get_label()): line for line in axes.get_lines() if not str(line.get_label()).startswith("_")}
    assert set(lines) == {"start", "end", "way of the tip", "ways of the other points"}
    assert lines["start"].get_marker() != lines["end"].get_marker()
    assert lines["start"].get_linestyle() != lines["end"].get_linestyle()


@pytest.mark.parametrize(("low", "high", "from_null"), [(3.4, 3.6, False), (0.0, 3.6, True), (1.0, 3.6, True), (3.5, 3.5, False)])
def test_inputs_fill_their_panel(low: float, high: float, from_null: bool) -> None:
    layout = SimpleNamespace(modules=1, actuators=2, actuator_names=("1", "2"))
    time = np.linspace(0, 1, 11)
    run: Any = SimpleNamespace(
        model=SimpleNamespace(layout=layout), simulation=SimpleNamespace(setpoints=SimpleNamespace(time=time)), hold=False
    )
    axes = Figure().subplots()
    _driven_axes(axes, run, "tension\nin N", np.column_stack([np.linspace(low, high, 11), np.full(11, high)]))
    bottom, top = axes.get_ylim()
    assert (bottom == 0) == from_null
    assert bottom <= low
    assert high <= top
    assert from_null or top - bottom < 0.08 * high


def test_points_of_a_bend_are_told_without_colour() -> None:
    time, random = np.linspace(0, 3, 31), np.random.default_rng(0)
    data = {"time": time, "model": random.normal(size=(31, 4, 3)), "prototype": random.normal(size=(31, 4, 3)), "errors": np.ones((31, 4))}
    result: Any = SimpleNamespace(data=data, numbers={"fig9_largest": 1.0})
    bend, errors = _fig9(result, np.zeros(3)).axes
    assert len({line.get_linestyle() for line in errors.get_lines()[:4]}) == 4
    assert len({(line.get_marker(), line.get_linestyle()) for line in bend.get_lines()[:8]}) == 8


def test_many_effects_at_once_have_a_short_name() -> None:
    """Their names one after the other would leave no room for the figure."""

    def named(count: int) -> str:
        return _label(SimpleNamespace(effects=tuple(SimpleNamespace(label=f"effect_{k}") for k in range(count))))  # type: ignore[arg-type]

    assert named(2) == "effect_0 + effect_1"
    assert named(8) == "8 effects together"

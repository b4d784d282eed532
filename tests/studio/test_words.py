"""What the page says of an operating point."""

from __future__ import annotations

import numpy as np

from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.studio.arm import drag_tip, off_grid, set_inputs
from tepm_opt.studio.words import describe_operating_point
from tests.tools import variant


def test_reached(kang: CompiledModel) -> None:
    point = drag_tip(kang, [0.12, -0.05, 0.34])
    text = describe_operating_point(point, off_grid(point))
    assert "x 120.0 · y -50.0 · z 340.0 mm" in text
    assert "**reached**" in text
    assert "No limit binds." in text
    assert "mm off" in text
    values = [f"{1e3 * value:.0f}" for value in np.linalg.svd(point.gain.normalise("tension"), compute_uv=False)]  # type: ignore[union-attr]
    assert f"| tension | {' | '.join(values)} |" in text


def test_out_of_reach(kang: CompiledModel) -> None:
    point = drag_tip(kang, [0.30, 0.20, 0.35])
    text = describe_operating_point(point, float("nan"))
    assert f"nearest point, **{1e3 * np.linalg.norm(point.held.tip - [0.30, 0.20, 0.35]):.1f} mm**" in text
    assert f"{len(point.limits)} limit" in text
    assert point.limits[0].replace("_", " ", 1) in text
    assert "grids" not in text


def test_set_inputs(kang: CompiledModel) -> None:
    text = describe_operating_point(set_inputs(kang, np.repeat([0.0, 7.0], 6)), 0.0)
    assert "**stable**" in text
    assert "6 limits bind" in text


def test_no_equilibrium() -> None:
    text = describe_operating_point(
        set_inputs(compile_model(variant(parameters={"m_d": 0.9}), backend="python"), np.zeros(12)), float("nan")
    )
    assert "**reached**" not in text
    assert "**stable**" not in text
    assert "singular" not in text

"""Units against their definitions, and there and back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tepm_opt.data.importing.maps import ImportMap, resolve_entries
from tepm_opt.data.importing.units import UNITS, factor, nearest
from tepm_opt.errors import InputError

PAIRS = [(dimension, unit) for dimension, units in UNITS.items() for unit in units]


@pytest.mark.parametrize(
    ("unit", "dimension", "si"),
    [
        ("psi", "pressure", 0.45359237 * 9.80665 / 0.0254**2),
        ("bar", "pressure", 1e5),
        ("atm", "pressure", 101325.0),
        ("mmHg", "pressure", 101325.0 / 760),
        ("kgf/cm2", "pressure", 98066.5),
        ("gf", "force", 9.80665e-3),
        ("lbf", "force", 0.45359237 * 9.80665),
        ("in", "length", 0.0254),
        ("deg", "angle", np.pi / 180),
        ("min", "time", 60.0),
    ],
)
def test_definitions(unit: str, dimension: str, si: float) -> None:
    assert factor(unit, dimension) == pytest.approx(si, rel=1e-12)


@pytest.mark.parametrize(("written", "meant"), [("KPA", "kPa"), ("Bar", "bar"), ("PSI", "psi"), ("millimeter", "mm"), ("newton", "N")])
def test_the_unit_that_was_meant(written: str, meant: str) -> None:
    dimension = next(dimension for dimension, unit in PAIRS if unit == meant)
    with pytest.raises(InputError, match=f"unit '{written}': valid: .*{meant}"):
        factor(written, dimension)
    assert nearest(written, dimension) in UNITS[dimension]
    if len(meant) > 1 and len(written) < 5:
        assert nearest(written, dimension) == meant


@given(st.sampled_from(PAIRS), st.floats(0.1, 10), st.floats(-3, 3), st.floats(-1e6, 1e6))
def test_there_and_back(pair: tuple[str, str], scale: float, offset: float, value: float) -> None:
    """An entry's unit, scale and offset undo what a laboratory did to a value in SI."""
    entry: dict[str, Any] = {"column": "v", "unit": pair[1], "scale": scale, "offset": offset}
    given_map = ImportMap.model_validate({"outputs": {"y": entry}, "noise": {"y": 1.0}})
    (only,) = resolve_entries(given_map, None, "map.toml")
    written = (value / factor(pair[1], pair[0]) - offset) / scale
    assert only.si * (only.source.scale * written + only.source.offset) == pytest.approx(value, rel=1e-9, abs=1e-6)

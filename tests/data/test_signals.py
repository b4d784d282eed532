"""Signals of any machine: each input alone, high and low outputs."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.data.signals import Signals


def test_signals_of_single_inputs_and_outputs() -> None:
    signals = Signals.from_names(("force", "valve"), ("level", "speed"), "m", (5.0, 2.0))
    assert [(part.by, part.name, part.columns) for part in signals.parts] == [("input", "force", (0,)), ("input", "valve", (1,))]
    found = {regime.name: (regime.columns, regime.measured, regime.low, regime.high) for regime in signals.regimes}
    assert found == {
        "high force": ((0,), False, 0.8, np.inf),
        "high valve": ((1,), False, 0.8, np.inf),
        "high level": ((0,), True, 0.8, np.inf),
        "low level": ((0,), True, -np.inf, 1 - 0.8),
        "high speed": ((1,), True, 0.8, np.inf),
        "low speed": ((1,), True, -np.inf, 1 - 0.8),
    }
    np.testing.assert_array_equal(signals.ranges, [5.0, 2.0])
    assert signals.axes == ("",)


def test_limits_need_not_be_known() -> None:
    signals = Signals.from_names(("force",), ("position",))
    assert signals.ranges.tolist() == [np.inf]
    assert Signals.from_names((), ("position",)).ranges.shape == (0,)


def test_signals_are_made_by_the_old_name() -> None:
    """The warning stands where the old name does."""
    with pytest.warns(DeprecationWarning, match=r"Signals\.of is now Signals\.from_names; the old name goes with version 0\.4"):
        old = Signals.of(("force",), ("position",), "m", (5.0,))
    assert old.inputs == ("force",)
    assert old == Signals.from_names(("force",), ("position",), "m", (5.0,))

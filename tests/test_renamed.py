"""Modules and methods by their old names."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest

from tepm_opt import LoopSetup

MOVED = {
    "tepm_opt.control.estimator": "tepm_opt.control.estimation.kalman_filter",
    "tepm_opt.control.controllers.base": "tepm_opt.control.controller",
    "tepm_opt.discrepancy.equations": "tepm_opt.discrepancy.adapters.equations",
    "tepm_opt.discrepancy.library.axis": "tepm_opt.discrepancy.laws.axis",
}


@pytest.mark.parametrize("old", MOVED)
def test_a_module_is_found_by_its_old_name(old: str) -> None:
    """What it has is the same; the warning tells the new name."""
    with pytest.warns(DeprecationWarning, match=rf"{old} is now {MOVED[old]}; the old name goes with version 0\.4"):
        found = import_module(old)
    new = import_module(MOVED[old])
    assert {name for name in vars(new) if not name.startswith("_")} <= set(vars(found))
    assert all(vars(found)[name] is vars(new)[name] for name in vars(new) if not name.startswith("__"))


def test_an_unknown_module_is_unknown() -> None:
    for name in ("tepm_opt.control.nothing", "tepm_opt.control.controllers.nothing"):
        with pytest.raises(ModuleNotFoundError):
            import_module(name)


def test_a_method_is_found_by_its_old_name() -> None:
    """The warning stands where the old name does."""
    old = "LoopSetup.of is now LoopSetup.from_options; the old name goes with version 0.4"
    with pytest.warns(DeprecationWarning, match=old) as told:
        found = LoopSetup.of("mode1", "bench", 3, {})
    assert found == LoopSetup.from_options("mode1", "bench", 3, {}) != LoopSetup()
    assert Path(told[0].filename) == Path(__file__)

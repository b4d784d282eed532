"""Modules and methods by their old names."""

from __future__ import annotations

import pkgutil
from importlib import import_module
from pathlib import Path

import pytest

from tepm_opt import Directions, Gain, Linear, LoopSetup, Model, Trajectory
from tepm_opt.control.references.reference import Reference
from tepm_opt.hw.simulation.imperfections.base import Imperfection
from tepm_opt.models.effect import Effect
from tepm_opt.solvers.linear.modal_model import ModalModel

MOVED = {
    "tepm_opt.control.estimator": "tepm_opt.control.estimation.kalman_filter",
    "tepm_opt.control.controllers.base": "tepm_opt.control.controller",
    "tepm_opt.discrepancy.equations": "tepm_opt.discrepancy.adapters.equations",
    "tepm_opt.discrepancy.library.axis": "tepm_opt.discrepancy.laws.axis",
    "tepm_opt.solvers.statics": "tepm_opt.solvers.mechanics.statics",
    "tepm_opt.solvers.start": "tepm_opt.solvers.identification.initial_state",
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


@pytest.mark.parametrize(("package", "new"), [("kinematics", "ik.solve_ik"), ("linear", "state_space.linearise")])
def test_names_of_a_module_that_is_a_package_now_are_found(package: str, new: str) -> None:
    old, name = f"tepm_opt.solvers.{package}", new.partition(".")[2]
    with pytest.warns(DeprecationWarning, match=rf"{old}\.{name} is now {old}\.{new}; the old name goes with version 0\.4") as told:
        found = getattr(import_module(old), name)
    assert found is pkgutil.resolve_name(f"{old}.{new}")
    assert Path(told[0].filename) == Path(__file__)
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = import_module(old).nothing


METHODS = [
    (Model, "of", "from_robot"),
    (Directions, "of", "from_names"),
    (Linear, "moving", "without_held_states"),
    (Reference, "begun", "rewind"),
    (Reference, "over", "is_over"),
    (Reference, "at", "rows_at"),
    (Trajectory, "resampled", "resample"),
    (Gain, "normalised", "normalise"),
    (ModalModel, "damped", "scale_damping"),
]


@pytest.mark.parametrize(("kind", "old", "new"), METHODS)
def test_a_method_is_found_by_its_old_name(kind: type, old: str, new: str) -> None:
    name = kind.__name__
    with pytest.warns(DeprecationWarning, match=rf"{name}\.{old} is now {name}\.{new}; the old name goes with version 0\.4"):
        assert getattr(kind, old) is getattr(kind, new)


def test_the_old_name_of_a_method_does_the_same() -> None:
    with pytest.deprecated_call():
        assert Model.of("kang2017") == Model.from_robot("kang2017")


def test_the_warning_of_an_old_name_stands_where_it_is_used() -> None:
    old = "LoopSetup.of is now LoopSetup.from_options; the old name goes with version 0.4"
    with pytest.warns(DeprecationWarning, match=old) as told:
        found = LoopSetup.of("mode1", "bench", 3, {})
    assert found == LoopSetup.from_options("mode1", "bench", 3, {}) != LoopSetup()
    assert Path(told[0].filename) == Path(__file__)


@pytest.mark.parametrize(("base", "old", "new"), [(Effect, "suggested", "suggest_values"), (Imperfection, "shaking", "base_motion")])
def test_a_hook_by_its_old_name_is_called_by_the_new_one(base: type, old: str, new: str) -> None:
    def hook(self: object) -> str:
        return "of the subclass"

    with pytest.warns(DeprecationWarning, match=rf"Mine\.{old} is now Mine\.{new}; the old name goes with version 0\.4"):
        mine = type("Mine", (base,), {old: hook, "__module__": __name__})
    assert getattr(mine, new) is hook

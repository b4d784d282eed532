"""The same data written into other columns give the same answer: a force of its own, in another unit, as what pushes and what pulls."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import casadi as ca
import numpy as np
import pytest

from tepm_opt.data.trials import read_trials
from tepm_opt.discrepancy.adapters.casadi_plant import CasadiPlant
from tepm_opt.discrepancy.adapters.equations import Equations
from tepm_opt.discrepancy.assessment.result import Verdict, VerdictStatus
from tepm_opt.discrepancy.laws.axis import AXIS
from tepm_opt.discrepancy.pipeline import discover
from tests.discrepancy.machines import Columns, drive_runs, written

AREA = 1e-4  # m²
FRICTION, OFFSET = 4.0, 3.0  # N
Force = Callable[[Equations], ca.SX]
ENCODINGS: dict[str, tuple[Force, Callable[[np.ndarray], dict[str, np.ndarray]]]] = {
    "force": (lambda m: m.input("force", size=50.0, unit="N"), lambda f: {"force": f}),
    "tip force": (lambda m: 1e3 * m.input("tip_kN", size=0.05, unit="kN"), lambda f: {"tip_kN": 1e-3 * f}),
    "guide": (
        lambda m: AREA * m.input("pressure", size=5e5, unit="Pa") - m.input("tension", size=50.0, unit="N"),
        lambda f: {"pressure": np.maximum(f, 0.0) / AREA, "tension": np.maximum(-f, 0.0)},
    ),
}


def plant_of(force: Force) -> CasadiPlant:
    m = Equations("drive", time=0.2, laws=[law for law in AXIS if law.name not in ("hysteresis", "stribeck_friction")])  # quicker
    q, v = m.state("q"), m.state("v")
    mass, viscous = m.parameter("mass", 10.0, "kg", within=0.2), m.parameter("viscous", 40.0, "N s/m", within=0.5)
    m.rate(q, v)
    m.rate(v, (force(m) - viscous * v + m.axis("rail", q, v, force=50.0, speed=0.5, position=0.2)) / mass)
    m.output("encoder", q, "m", size=0.2)
    return m.plant(between="hold")


@pytest.fixture(scope="module")
def runs() -> dict[str, Columns]:
    return drive_runs(FRICTION, OFFSET, seconds=4.0)


@pytest.fixture(scope="module")
def verdict_of(runs: dict[str, Columns], tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Verdict]:
    """The answer to a way of writing the force down, found once."""

    @cache
    def found(name: str) -> Verdict:
        force, columns = ENCODINGS[name]
        plant = plant_of(force)
        same = {file: {k: v for k, v in run.items() if k != "force"} | columns(run["force"]) for file, run in runs.items()}
        folder = written(tmp_path_factory.mktemp("data") / name, {"encoder": 1e-4}, same, "free", "piece_s = 2.0\n")
        return discover(read_trials(folder, plant.signals), plant, 1e-4).verdict

    return found


@pytest.mark.slow
def test_what_is_there_is_named_and_nothing_else(verdict_of: Callable[[str], Verdict]) -> None:
    verdict = verdict_of("force")
    assert verdict.status is VerdictStatus.NAMED, verdict.paragraph
    sizes = {each.candidate.label: each.parameters["force"].value for each in verdict.effects}
    assert sizes == {"dry_friction[rail]": pytest.approx(FRICTION, rel=0.02), "constant_force[rail]": pytest.approx(OFFSET, rel=0.02)}
    assert all(rival.probability < 0.5 for rival in verdict.rivals)


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param("tip force", marks=pytest.mark.slow), "guide"])
def test_other_columns_give_the_same_answer(verdict_of: Callable[[str], Verdict], name: str) -> None:
    one, other = verdict_of("force"), verdict_of(name)
    assert other.status is one.status
    assert [each.candidate for each in other.effects] == [each.candidate for each in one.effects]
    for each, same in zip(other.effects, one.effects, strict=True):
        assert each.probability == pytest.approx(same.probability, abs=1e-3)
        for parameter, value in each.parameters.items():
            assert value.value == pytest.approx(same.parameters[parameter].value, rel=1e-3)
    for parameter, value in other.recalibrated.items():
        assert value.value == pytest.approx(one.recalibrated[parameter].value, rel=1e-3)
    for model in ("nominal", "recalibrated", "corrected"):
        assert getattr(other.errors, model) == pytest.approx(getattr(one.errors, model), rel=1e-3)
    assert {rival.candidate for rival in other.rivals} == {rival.candidate for rival in one.rivals}

"""Trials whose robot is a Cosserat rod: sections with the network's energy, muscles in their places, and the same robot as ours."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.hw.simulation.imperfections.base import Body
from tepm_opt.models.effects import effects
from tepm_opt.models.robot import load_robot
from tepm_opt.studies.blind.engine import ROD
from tepm_opt.studies.blind.excitation import Excitation, excitations
from tepm_opt.studies.blind.judged import Judged
from tepm_opt.studies.blind.machine import Deviation, rig_file, simulate_run
from tepm_opt.studies.blind.rod_causes import KNOWN, UNKNOWN
from tepm_opt.studies.blind.rod_design import ActuatorLine, RodDesign
from tepm_opt.studies.blind.rod_kernel import Material, RodArrays, find_active_stress, set_element_law, set_node_law
from tepm_opt.studies.blind.rod_section import AT_REST, UnitCell
from tepm_opt.studies.blind.rod_world import load_elastica
from tepm_opt.studies.blind.run import examine_trial
from tepm_opt.studies.blind.trial import CYCLE, Trial

ROBOT = load_robot("kang2017")
NULL = 11  # number of a trial of seed 0 that hides nothing
TICK = 4e-3  # s


def make_cell(**changed: float) -> UnitCell:
    return UnitCell.from_body(Body.from_robot(ROBOT.model_copy(update={"parameters": ROBOT.parameters.model_copy(update=changed)})))


def find_stretched_energy(stretch: float) -> float:
    """Energy per length of a stretched segment, from the lengths of its 3 vertical, 3 horizontal and 6 diagonal edges."""
    value, height = ROBOT.parameters, ROBOT.parameters.L_0 / 6
    side, stiffness = value.r * np.sqrt(3), 6 * value.K_a

    def energy(narrower: float) -> float:
        diagonal = np.hypot(side - narrower, stretch * height) - np.hypot(side, height)
        squares = 3 * ((stretch - 1) * height) ** 2 + 3 * value.alpha_1 * narrower**2 + 6 * value.alpha_2 * diagonal**2
        return 0.5 * stiffness * squares / height

    narrower = minimize_scalar(energy, bounds=(-1e-3, 1e-3), method="bounded", options={"xatol": 1e-12})["x"]  # type: ignore[index]
    return float(energy(narrower))


@pytest.mark.parametrize("stretch", [0.95, 1.0, 1.2])
def test_a_stretched_section_has_the_energy_of_its_edges(stretch: float) -> None:
    assert make_cell().find_energy(AT_REST * stretch) == pytest.approx(find_stretched_energy(stretch), rel=1e-9, abs=1e-15)


def test_without_diagonals_only_muscles_resist() -> None:
    """Axial stiffness is that of three springs, bending stiffness has the second moment of three places, and shear is free."""
    value = ROBOT.parameters
    shear, axial, bending, torsion = make_cell(alpha_2=1e-9).fit_law().stiffness[:, -1]
    each = value.K_a * value.L_0  # N
    assert axial == pytest.approx(3 * each, rel=1e-5)
    assert bending == pytest.approx(1.5 * each * value.r**2, rel=1e-3)
    assert shear < 0.01 * axial
    assert torsion < 0.01 * bending


def test_a_section_is_the_same_after_a_third_of_a_turn() -> None:
    """But not after half a turn, as the section is a triangle."""
    cell, strain = make_cell(), np.array([0.05, -0.02, 1.08, 0.7, 0.4, 0.5])

    def find_turned_energy(angle: float) -> float:
        turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
        return cell.find_energy(np.concatenate([turn @ strain[:3], turn @ strain[3:]]))

    assert find_turned_energy(2 * np.pi / 3) == pytest.approx(cell.find_energy(strain), rel=1e-12)
    assert find_turned_energy(np.pi) != pytest.approx(cell.find_energy(strain), rel=1e-5)


def make_rod(elements: int) -> RodArrays:
    def diagonal(count: int) -> np.ndarray:
        return np.zeros((3, 3, count))

    vectors, inner = np.zeros((3, elements)), np.zeros((3, elements - 1))
    return RodArrays(
        vectors, inner, np.ones(elements), np.ones(elements - 1), diagonal(elements), diagonal(elements - 1), vectors.copy(), inner.copy(),
        diagonal(elements), diagonal(elements),
    )  # fmt: skip


def test_a_muscle_pushes_and_bends_at_its_place() -> None:
    """An upper muscle pushes with its force and bends by its lever; the lower module's stays as it is."""
    elements, push, place, axial, bending = 5, 7.0, np.array([0.03, -0.02]), 300.0, 0.2
    rod, active = make_rod(elements), np.empty((6, elements))
    material = Material(
        np.array([[170.0], [axial], [bending], [0.1]]), np.zeros((6, 6, 6)), np.ones(elements), np.zeros(3), np.ones(3), place[None],
        np.array([0, 0, 0, 1, 1]), 0.0, 0.0, 2.0, 50.0,
    )  # fmt: skip
    find_active_stress(rod, material, np.array([[0.0], [push]]), active)
    lever = np.cross([*place, 0.0], [0.0, 0.0, push])
    np.testing.assert_allclose(active[:, :3], 0.0)
    np.testing.assert_allclose(active[:, 3], [0.0, 0.0, push, *lever])
    set_element_law(rod, material, active, np.zeros((3, elements)))
    set_node_law(rod, material, active, np.zeros((3, elements - 1)))
    np.testing.assert_allclose(rod.rest_sigma[:, 4], [0.0, 0.0, push / axial])
    np.testing.assert_allclose(rod.rest_kappa[:, 3], lever / [bending, bending, 0.1])
    np.testing.assert_allclose(rod.rest_kappa[:, 2], rod.rest_kappa[:, 3] / 2)  # the modules' common node
    np.testing.assert_allclose(rod.bend_matrix[0, 0], [2 * bending, bending, bending, bending])


def test_inputs_come_late_filtered_and_changed() -> None:
    before, after = np.full(12, 1e5), np.full(12, 2e5)
    late = ActuatorLine(RodDesign(delay=3 * TICK), TICK)
    late.settle(before)
    assert [late.advance(after)[0] for _ in range(5)] == [1e5, 1e5, 1e5, 2e5, 2e5]
    filtered = ActuatorLine(RodDesign(filling=0.05), TICK)
    filtered.settle(before)
    middles = np.array([filtered.advance(after) for _ in range(10)])
    np.testing.assert_allclose(middles[:, 0], 2e5 - 1e5 * np.exp(-(np.arange(10) + 0.5) * TICK / 0.05))
    np.testing.assert_allclose(middles[:, 6], 2e5)
    design = RodDesign()
    KNOWN["weak_bladder"](np.random.default_rng(1)).at(0.05).build(design, Body.from_robot(ROBOT))  # type: ignore[misc]
    acting = ActuatorLine(design, TICK).settle(before)
    assert sorted(np.abs(acting / before - 1))[-2:] == pytest.approx([0.0, 0.05])


def test_the_names_are_those_of_effects() -> None:
    random = np.random.default_rng(0)
    names = {name for cause in KNOWN.values() for name in cause(random).names}
    assert len(names) == len(KNOWN)
    assert names <= {effect.name for effect in effects()}
    assert not any(cause(random).names for cause in UNKNOWN.values())
    assert "rod" not in CYCLE


def test_without_the_package_it_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "elastica", None)
    load_elastica.cache_clear()
    with pytest.raises(InputError, match=r"pip install 'tepm-opt\[rod\]'"):
        load_elastica()


@pytest.fixture
def run() -> Excitation:
    """First seconds of a run with all inputs at once, where PyElastica is installed."""
    pytest.importorskip("elastica", reason="extra rod")
    run = next(run for run in excitations(1, short=True) if run.file == "mixed.csv")
    asked = run.setpoints
    return replace(run, setpoints=SetPoints(asked.time[:120], asked.inputs[:120], asked.tip_force[:120]))


@pytest.mark.slow
def test_with_nothing_hidden_it_is_nearly_the_same_robot(run: Excitation) -> None:
    """Rod and network differ by less than the smallest noise before anything is recalibrated."""
    factors = Deviation(factors={"K_a": 1.02, "c_a": 0.8})
    ours = simulate_run(rig_file(ROBOT, factors, 0.0), factors, run, 0).points
    assert np.sqrt(np.mean((ROD.simulate(ROBOT, factors, [run])[0] - ours) ** 2)) < 1.5e-4


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "at"),
    [
        ("filtered_bladders", lambda size: {"regulator_lag": {"fill_s": size, "exhaust_s": size}}),
        ("delayed_actuators", lambda size: {"time_delay": {"delay_s": size}}),
        ("heavy_tip", lambda size: {"payload": {"mass_kg": size}}),
    ],
)
def test_a_cause_does_what_the_rig_does_by_other_means(run: Excitation, key: str, at: Callable[[float], dict[str, Any]]) -> None:
    form = KNOWN[key](np.random.default_rng(1))
    rig = Deviation(at(form.usual))
    change = ROD.simulate(ROBOT, form.at(form.usual), [run])[0] - ROD.simulate(ROBOT, Deviation(), [run])[0]
    ours = [simulate_run(rig_file(ROBOT, machine, 0.0), machine, run, 0).points for machine in (Deviation(), rig)]
    assert np.linalg.norm(change - (ours[1] - ours[0])) < 0.05 * np.linalg.norm(change)


@pytest.mark.slow
@pytest.mark.parametrize("key", [*KNOWN, *UNKNOWN])
def test_every_cause_moves_the_robot(run: Excitation, key: str) -> None:
    form = (KNOWN | UNKNOWN)[key](np.random.default_rng(1))
    plain, changed = (ROD.simulate(ROBOT, machine, [run])[0] for machine in (Deviation(), form.at(form.usual)))
    assert np.abs(changed - plain).max() > 5e-4


@pytest.mark.slow
def test_a_whole_trial() -> None:
    """Nothing is hidden: that the rod is another body may be seen, but no cause is named."""
    pytest.importorskip("elastica", reason="extra rod")
    found = examine_trial(Trial.from_number(0, NULL, "rod"))
    assert found["error"] is None
    assert found["label"]["kind"] == "null"
    assert found["verdict"]["status"] in ("no_discrepancy", "unexplained")
    assert not Judged(found).said

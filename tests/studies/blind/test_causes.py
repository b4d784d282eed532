"""Causes that blind trials hide: each is what its label says, and its size makes it matter as much as asked."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from tepm_opt.data.run import Run
from tepm_opt.models.robot import Robot, load_robot
from tepm_opt.studies.blind.causes import LIBRARY, Cause
from tepm_opt.studies.blind.excitation import excitations
from tepm_opt.studies.blind.flaws import CLOCKS, POOR, add_feedback, mistaken, spoil_run
from tepm_opt.studies.blind.foreign import FOREIGN
from tepm_opt.studies.blind.machine import Deviation, combine_deviations, rig_file, simulate_run
from tepm_opt.studies.blind.sizes import UNBEARABLE, Pilot, simulate_points

ROBOT = load_robot("kang2017")
NOISE = 3e-4
RUNS = excitations(1, short=True)
SHORT = [run for run in RUNS if run.file in ("mixed.csv", "single_tension.csv")]


def test_deviations_add() -> None:
    """Factors multiply, changes act one after the other."""
    double = Deviation(factors={"K_a": 2.0}, after=lambda time, points: 2 * points)
    more = Deviation({"payload": {"mass_kg": 0.1}}, {"K_a": 1.1, "r": 0.9}, after=lambda time, points: points + 1)
    both = combine_deviations([double, more])
    assert both.factors == {"K_a": pytest.approx(2.2), "r": 0.9}
    assert both.imperfections == {"payload": {"mass_kg": 0.1}}
    assert both.after is not None
    assert both.after(np.zeros(1), np.ones(1)) == 3
    assert both.before is None


def test_a_value_that_no_rig_has_is_not_borne() -> None:
    """A form whose size runs out of the rig file's range gets another size."""
    with pytest.raises(UNBEARABLE, match="c_a"):
        rig_file(ROBOT, Deviation(factors={"c_a": 0.19}), NOISE)


def test_noise_comes_behind_what_acts_on_points() -> None:
    """A point that stands still is measured anew each time."""
    still = Deviation(after=lambda time, points: np.broadcast_to(points[:1], points.shape).copy())
    run = simulate_run(rig_file(ROBOT, still, NOISE), still, SHORT[0], 3)
    assert run.points.std(axis=0) == pytest.approx(np.full((4, 3), NOISE), rel=0.2)


@pytest.mark.slow
def test_a_misfit_is_what_recalibration_cannot_take() -> None:
    """A parameter within its prior leaves nothing, however it bends; one beyond it no more than what is beyond."""
    pilot = Pilot.from_simulation(ROBOT, Deviation(), SHORT, NOISE)
    stiff = mistaken(ROBOT)["K_a"](np.random.default_rng(0))

    def apart(one: float, other: float) -> float:
        both = [simulate_points(ROBOT, stiff.at(size), SHORT, 50.0) for size in (one, other)]
        return float(np.sqrt(np.mean((both[0] - both[1]) ** 2)) / NOISE)

    assert pilot.misfit(stiff, 0.02) < 0.02 * apart(0.02, 0.0)
    assert 0.15 * apart(0.06, 0.03) < pilot.misfit(stiff, 0.06) < 1.1 * apart(0.06, 0.03)


def test_recalibration_ends_at_the_priors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a change that is three half-widths along one parameter alone, one is taken from the middle, one and a half from the lower half."""
    columns = np.linalg.qr(np.random.default_rng(0).normal(size=(60, len(ROBOT.priors))))[0]
    change = 3 * columns[:, list(ROBOT.priors).index("m_d")]
    for start, left in ((0.0, 2.0), (-0.5, 1.5)):
        at = Deviation(factors={"m_d": 1 + start * ROBOT.priors["m_d"]})

        def linear(robot: Robot, machine: Deviation, *rest: object, at: Deviation = at) -> np.ndarray:
            moved = [(machine.factors.get(name, 1.0) - at.factors.get(name, 1.0)) / width for name, width in ROBOT.priors.items()]
            return change * ("payload" in machine.imperfections) + columns @ moved

        monkeypatch.setattr("tepm_opt.studies.blind.sizes.simulate_points", linear)
        pilot = Pilot(ROBOT, at, SHORT, NOISE, 50.0, np.zeros(60), columns)
        assert pilot.misfit(LIBRARY["payload"](np.random.default_rng(0)), 1.0) == pytest.approx(left / np.sqrt(60) / NOISE)


@pytest.mark.slow
@pytest.mark.parametrize("table", [LIBRARY, FOREIGN, CLOCKS, mistaken(ROBOT)], ids=["library", "foreign", "clocks", "parameters"])
def test_every_cause_can_be_hidden(table: Mapping[str, Cause]) -> None:
    """The machine bears it at a size that leaves three times the noise, or the nearest that its limits let it leave."""
    pilot = Pilot.from_simulation(ROBOT, Deviation(), RUNS, NOISE)
    found: dict[str, float] = {}
    for key, cause in table.items():
        for seed in range(4):  # a wall may stand where the tip never comes
            form = cause(np.random.default_rng(seed))
            size, misfit = pilot.find_size(form, 3.0)
            assert form.low <= size <= form.high
            assert set(form.detail) <= set(form.names)
            found[key] = max(misfit, found.get(key, 0.0))
            if misfit > 1:
                break
    assert all(misfit > 1 for misfit in found.values()), found


@pytest.mark.parametrize("key", [key for key, flaw in POOR.items() if flaw.spoil])
def test_poor_data_stay_mostly_what_they_were(key: str) -> None:
    random = np.random.default_rng(0)
    time = np.arange(500) / 50
    run = Run("a.csv", "fit", time, np.zeros((500, 12)), np.zeros((500, 3)), 0.1 * np.sin(time)[:, None, None] * np.ones((500, 4, 3)))
    found = spoil_run(run, POOR[key], random, NOISE).points
    lost = np.isnan(found).any(axis=2)
    moved = np.abs(np.where(lost[..., None], run.points, found) - run.points).max(axis=2)
    share = {"gaps": (0.25, 0.35), "hidden_points": (0.12, 0.13)}.get(key, (0.0, 0.0))
    assert share[0] <= lost.mean() <= share[1]
    assert (moved > 0).mean() == pytest.approx({"outliers": 0.0025, "coarse_grid": 0.998}.get(key, 0.0), abs=2e-3)
    assert moved.max() <= {"outliers": 0.01, "coarse_grid": NOISE}.get(key, 0.0) + 1e-9


def test_a_controller_pushes_the_tip_back() -> None:
    """Feedback on a machine that leans takes part of what it leans by."""
    leaning = Deviation({"external_load": {"force_N": (0.03, 0.0, 0.0)}})
    run = SHORT[-1]
    goal = simulate_run(rig_file(ROBOT, Deviation(), 0.0), Deviation(), run, 0).points
    before = simulate_run(rig_file(ROBOT, leaning, 0.0), leaning, run, 0).points
    held = add_feedback(run.setpoints, before, goal)
    after = simulate_run(rig_file(ROBOT, leaning, 0.0), leaning, type(run)(run.file, run.role, held), 0).points
    off = [np.abs((points - goal)[100:, -1, 0]).mean() for points in (before, after)]
    assert off[0] > 1e-3
    assert 0.2 * off[0] < off[1] < 0.8 * off[0]

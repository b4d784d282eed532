"""Changes of the machine while a loop is closed: found, named, and nothing told where there is none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.control.diagnostics.causes import BODY, MOTOR, REGULATOR, FaultHypothesisTest, causes
from tepm_opt.control.diagnostics.change_detection import GlrStatistics, PrewhiteningFilter, Sums
from tepm_opt.control.diagnostics.monitor import DEFAULT, EVIDENCE, Watched, attach_monitor
from tepm_opt.control.diagnostics.signatures import BLOCK, FaultRegressors
from tepm_opt.control.loop import LoopRecord, close_loop
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.control.references.reference import Reference, approach, point_by_point, reference_of
from tepm_opt.hw.rig import Sample
from tepm_opt.hw.simulation.family import random_machine
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.planning.trajectories import circle
from tests.control.changes import Change, Changing, change_of, path
from tests.control.study import APPROACH, model

SPREADS = np.array([1.0, 2.0])


def regression(seed: int, change: float) -> tuple[np.ndarray, np.ndarray]:
    """Two columns and white noise of unit variance over 200 rows, of which the second column gains `change` from the 120th on."""
    random = np.random.default_rng(seed)
    columns = np.column_stack([np.ones(200), np.sin(np.arange(200) / 7)])
    size = np.array([0.5, -1.0]) + np.outer(np.arange(200) >= 120, [0.0, change])
    return columns, (columns * size).sum(axis=1) + random.standard_normal(200)


def sums_of(columns: np.ndarray, measured: np.ndarray) -> Sums:
    sums = Sums(SPREADS, 1, marks=30, least=1.0)
    for k, row in enumerate(np.column_stack([measured, columns])):
        if k >= 50 and k % 5 == 0:
            sums.mark()
        sums.add(row[None, None])
    return sums


def test_score_and_information_are_those_of_a_column_that_begins_at_a_mark() -> None:
    """Against the regression with that column written down, whatever θ is."""
    columns, measured = regression(1, 2.0)
    sums = sums_of(columns, measured)
    left = sums.score_changes()
    late = columns[:, 1] * (np.arange(200) >= 120)
    inverse = np.linalg.inv(columns.T @ columns + np.diag(SPREADS**-2.0))
    theta = inverse @ columns.T @ measured
    noise = ((measured[:50] ** 2).sum() - _explained(columns[:50], measured[:50])) / 50
    scale = max(noise, 1.0)
    assert left.score[14, 0, 1] == pytest.approx(late @ (measured - columns @ theta) / scale)
    assert left.information[14, 0, 1, 1] == pytest.approx((late @ late - late @ columns @ inverse @ columns.T @ late) / scale)
    assert np.argmax(left.score[:, 0, 1] ** 2 / left.information[:, 0, 1, 1]) in range(12, 18), "the change began at the 15th mark"
    size = left.score[14, 0, 1] / left.information[14, 0, 1, 1]
    rows, misfit = sums.measure_misfit(14, 0, 0.5 * size * left.score[14, 0, 1], left.noise)
    begun, changed = np.arange(200) < 120, measured - size * late
    left_after = (changed**2).sum() - _explained(columns, changed)
    left_before = (measured[begun] ** 2).sum() - _explained(columns[begun], measured[begun])
    assert (rows, misfit) == (80, pytest.approx((left_after - left_before) / scale))


def test_a_mark_before_any_row_tells_of_no_change() -> None:
    """No residual says what is noise; it was 0 / 0, with a warning on the terminal."""
    sums = Sums(SPREADS, 1, marks=30, least=1.0)
    sums.mark()
    sums.add(np.column_stack([*regression(1, 2.0)[::-1]])[None])
    left = sums.score_changes()
    assert not left.score.any()
    assert not left.information.any()


def _explained(columns: np.ndarray, measured: np.ndarray) -> float:
    by = columns.T @ measured
    return float(by @ np.linalg.solve(columns.T @ columns + np.diag(SPREADS**-2.0), by))


@pytest.mark.parametrize("places", [np.zeros(60, dtype=int), np.arange(60) % 4])
def test_whitened_rows_are_those_of_the_covariance(places: np.ndarray) -> None:
    """What is slow, what belongs to a place and white noise together, by Cholesky's factor of their covariance."""
    random = np.random.default_rng(2)
    rows, kept = random.standard_normal((60, 1, 2)), np.exp(-1.0 / 3.0)
    slow = 0.7**2 * kept ** np.abs(np.subtract.outer(np.arange(60), np.arange(60)))
    covariance = slow + 0.5**2 * (places[:, None] == places) + 0.3**2 * np.eye(60)
    whole = np.linalg.solve(np.linalg.cholesky(covariance), rows[:, 0])
    filtered = PrewhiteningFilter(np.array([0.7]), np.array([3.0]), 1, 2, 1.0)
    own = np.array([[0.25]])
    found = np.array(
        [filtered.whiten(row, np.eye(1), np.array([[0.09]]), int(k), own, 0 * own) for row, k in zip(rows, places, strict=True)]
    )[:, 0]
    if (places == places[0]).all():
        assert found == pytest.approx(whole)
    else:  # what a place and the slow disturbance share is forgotten when it is left
        assert found == pytest.approx(whole, abs=0.8)
        assert found.var() == pytest.approx(whole.var(), rel=0.25)


def test_causes_have_names_of_their_own_and_words(kang: CompiledModel, short: Reference) -> None:
    body = FaultRegressors(kang, short, Mpc(kang, short).start()).body
    every = causes(kang.layout.actuator_names, kang.layout.point_names, body)
    assert len({cause.about for cause in every}) == len(every)
    assert sum(cause.prior for cause in every) == pytest.approx(1.0, abs=0.01)
    words = {cause.about: cause.describe(0.1) for cause in every}
    assert words["strength 13"] == "muscle 13 pulls 10 % more"
    assert next(cause for cause in every if cause.about == "strength 13").describe(-0.1) == "muscle 13 pulls 10 % less"
    assert words["payload put on"] == "100 g were put on the tip"


def test_a_change_along_a_cause_is_weighed_highest(kang: CompiledModel, short: Reference) -> None:
    """A score that is exactly what a cause would make: its evidence is the largest, its size is right to within the prior."""
    signatures = FaultRegressors(kang, short, Mpc(kang, short).start())
    every, count = causes(kang.layout.actuator_names, kang.layout.point_names, signatures.body), len(signatures.spreads)
    random = np.random.default_rng(3)
    factor = random.standard_normal((300, count))
    information = 1e3 * factor.T @ factor
    column = signatures.body["tension"].start + 1

    def still(machines: int, columns: int) -> GlrStatistics:
        information = np.tile(np.eye(columns), (1, machines, 1, 1))
        return GlrStatistics(np.zeros((1, machines, columns)), information, np.zeros((machines, columns)), np.ones(machines))

    body = GlrStatistics(0.3 * information[None, None, column], information[None, None], np.zeros((1, count)), np.ones(1))
    found, sizes = FaultHypothesisTest(every, {BODY: count, REGULATOR: 4, MOTOR: 2}).evidence(
        {BODY: body, REGULATOR: still(6, 4), MOTOR: still(6, 2)}
    )
    best = int(found[0].argmax())
    assert every[best].about == "tendon 12"
    assert sizes[0, best] == pytest.approx(0.3, rel=1e-3)


def test_rows_of_points_are_small_where_the_rig_is_nearly_the_model(kang: CompiledModel, short: Reference, followed: LoopRecord) -> None:
    """On the virtual prototype the slow part of what is left is some newtons of axial force; blocks with a point unseen are left out."""
    signatures = FaultRegressors(kang, short, followed.controller.start() if hasattr(followed, "controller") else Mpc(kang, short).start())
    rows = []
    for k, (points, measured) in enumerate(zip(followed.points, followed.measured, strict=True)):
        sample = Sample(followed.time[k], points if not 200 <= k < 210 else np.full_like(points, np.nan), measured[:6], measured[6:])
        rows.append(signatures.add(sample, followed.commands[k], followed.rows[k]))
    found = [row for row in rows if row is not None]
    assert len(rows) // BLOCK - 8 <= len(found) <= len(rows) // BLOCK - 4
    forces = [np.linalg.lstsq(row.gain, row.points[:, 0], rcond=1e-2)[0] for row in found]
    assert np.abs(forces).max() < 5.0
    assert all(row.points.shape == (12, 1 + len(signatures.spreads)) for row in found)


@pytest.fixture(scope="module")
def quick() -> Reference:
    """Two laps of the circle."""
    return path("circle", 19.5)


def watch(reference: Reference, kind: str, at: float, seed: int = 1) -> tuple[LoopRecord, Watched]:
    """The circle on a random machine to which something happens; the monitor learns for 8 s alone, as the runs are short."""
    controller = attach_monitor(Mpc(model(), reference), model(), replace(DEFAULT, learns=8.0))
    assert isinstance(controller, Watched)
    change = change_of(kind, np.random.default_rng(seed)) if kind else None
    return close_loop(Changing(random_machine("kang2017", 71001, 2), change, at, seed), controller, model().robot), controller


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "seed", "least"),
    [("payload on", 1, 0.9), ("regulator leaks", 2, 0.9), ("regulator leaks", 1, 0.3), ("dynamometer", 1, 0.9), ("tracked point", 1, 0.9)],
)
def test_a_change_is_told_and_named(quick: Reference, kind: str, seed: int, least: float) -> None:
    """By the pressure of muscle 22 (leak, seed 1) on the circle, a leak and a monitor that reads less are told apart hardly."""
    done, controller = watch(quick, kind, 11.5, seed)
    changes = controller.monitor.changes
    layout, change = model().layout, change_of(kind, np.random.default_rng(seed))
    assert len(changes) == 1
    true = change.names(layout.actuator_names[change.number], layout.point_names[change.point])
    assert sum(changes[0].probabilities.get(name, 0.0) for name in true) > least
    assert 11.5 <= changes[0].told < 21.5
    assert "machine" in done.telemetry[-1].doubts
    assert sum(changes[0].probabilities.values()) <= 1 + 1e-9


@pytest.mark.slow
def test_a_tip_marker_that_slips_by_3_mm_is_told(quick: Reference) -> None:
    """By the shape over some seconds: the jump alone is within the noise."""

    def slipped(sample: Sample, change: Change) -> Sample:
        return replace(sample, points=sample.points + np.outer([0, 0, 0, 1], 3e-3 * change.way))

    change = Change(0, 3, np.array([0.6, 0.0, 0.8]), lambda _, point: (f"marker {point}",), lie=slipped)
    controller = attach_monitor(Mpc(model(), quick), model(), replace(DEFAULT, learns=8.0))
    assert isinstance(controller, Watched)
    done = close_loop(Changing(random_machine("kang2017", 71001, 3), change, 11.5, 1), controller, model().robot)
    assert "marker s4" not in done.telemetry[-1].doubts
    assert controller.monitor.changes[0].told < 17.5
    assert controller.monitor.changes[0].probabilities["marker s4"] > 0.9


@pytest.mark.slow
def test_nothing_is_told_of_a_machine_that_stays_and_commands_are_the_same(quick: Reference) -> None:
    done, controller = watch(quick, "", np.inf)
    assert not controller.monitor.changes
    assert max(float(row.columns[EVIDENCE]) for row in done.telemetry) < DEFAULT.evidence
    rig = SimulatedRig(random_machine("kang2017", 71001, 2))
    rig.reseed(1)
    alone = close_loop(rig, Mpc(model(), quick), model().robot)
    assert all(np.array_equal(a.tensions, b.tensions) for a, b in zip(done.commands, alone.commands, strict=True))


@pytest.mark.slow
def test_places_that_are_new_tell_of_no_change() -> None:
    """Thirty-two stops on the virtual prototype, none of them twice: how it differs there from its model is news, not a change."""
    stops, *_ = point_by_point(circle(32).positions, 1.0, 3.0, 1.0)
    reference = reference_of(model(), np.vstack([approach(model(), stops[0], APPROACH), stops]))
    controller = attach_monitor(Mpc(model(), reference), model())
    assert isinstance(controller, Watched)
    rig = SimulatedRig()
    rig.reseed(0)
    close_loop(rig, controller, model().robot)
    assert not controller.monitor.changes


@pytest.mark.slow
def test_what_was_measured_since_is_a_data_set(quick: Reference, tmp_path: Path) -> None:
    import tepm_opt as tepm
    from tepm_opt.jobs.closed_loop import ClosedLoop, LoopSetup
    from tepm_opt.jobs.refit import CHANGED

    done, controller = watch(quick, "payload on", 11.5)
    loop = replace(ClosedLoop.from_record(done, model(), LoopSetup()), changes=tuple(controller.monitor.changes))
    loop.save(tmp_path)
    assert loop.summary()["changes"][0]["probabilities"]
    (found,) = tepm.open_datasets([tmp_path / CHANGED], False)
    assert found.runs[0].duration > 5.0

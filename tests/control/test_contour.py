"""Free progress: the timing law against its limits, the governed clock, the distance from a path, and a closed loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tepm_opt.control.loop import close_loop
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.control.references.path_following import FINE, PathFollowingReference, contour_errors
from tepm_opt.control.references.time_optimal import PaceSettings, retime
from tepm_opt.errors import InputError
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.jobs.closed_loop import ClosedLoop, LoopSetup
from tepm_opt.jobs.course import Course, whole_reference
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.linear.modal_model import modal_model
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.solvers.planning.trajectories import Trajectory, circle, line, lissajous

QUICK = Course(approach=1.5, pause=0.1, start_up=0.3, pace=PaceSettings())


def lap(path: Trajectory) -> float:
    """Time of a lap in s."""
    return 2 * path.time[-1] - path.time[-2]


class TestTiming:
    def test_a_circle_is_as_fast_as_its_curvature_allows(self, kang: CompiledModel) -> None:
        """v²/r = ω² δ, with the softest mode of the arm along the path; twice the sway is 1/√2 of the time."""
        path = retime(kang, circle(200), PaceSettings(sway=0.004))
        speed = 2 * np.pi * 0.150 / lap(path)
        soft = speed**2 / 0.150 / 0.004
        rest = modal_model(solve_statics(kang, np.zeros(12))).stiffness[0]
        assert 0.3 * rest < soft < 1.5 * rest
        assert lap(retime(kang, circle(200), PaceSettings(sway=0.008))) == pytest.approx(lap(path) / np.sqrt(2), rel=1e-3)

    def test_actuators_limit_where_inertia_does_not(self, kang: CompiledModel) -> None:
        """Twice what they may do is half the time, where the speed itself has no limit."""
        wild = PaceSettings(sway=100.0, fastest=100.0, reserve=0.8)
        slow, fast = (retime(kang, circle(200), replace(wild, reserve=reserve)) for reserve in (0.8, 0.6))
        assert lap(slow) == pytest.approx(2 * lap(fast), rel=1e-6)

    def test_it_slows_where_the_path_bends_and_forgets_the_time_it_had(self, kang: CompiledModel) -> None:
        path = retime(kang, lissajous(300, duration=6.0))
        again = retime(kang, lissajous(300, duration=60.0))
        np.testing.assert_allclose(path.time, again.time)
        speed = np.linalg.norm(np.diff(path.positions, axis=0), axis=1) / np.diff(path.time)
        assert speed.max() > 2 * speed.min()

    def test_an_open_path_begins_and_ends_slowly(self, kang: CompiledModel) -> None:
        path = retime(kang, line(40))
        speed = np.linalg.norm(np.diff(path.positions, axis=0), axis=1) / np.diff(path.time)
        assert not path.closed
        assert max(speed[0], speed[-1]) < 0.3 * speed.max()
        np.testing.assert_allclose(path.positions[[0, -1]], line(40).positions[[0, -1]], atol=1e-12)

    def test_no_path(self, kang: CompiledModel) -> None:
        same = Trajectory(np.arange(3.0), np.array([[0.1, 0, 0.35]] * 3))
        with pytest.raises(InputError, match="valid: at least 3"):
            retime(kang, same)


class TestClock:
    @pytest.fixture
    def reference(self) -> PathFollowingReference:
        tips = np.linspace(0, 1, 801)[:, None] * np.array([1.0, 0.0, 0.0])
        return PathFollowingReference(tips, np.zeros((801, 6)), [], np.ones(801, dtype=bool), np.zeros(801, dtype=int))

    def test_runs_at_full_speed_by_itself(self, reference: PathFollowingReference) -> None:
        np.testing.assert_array_equal(reference.rows_at(np.array([-3, 0, 1, 10, 1000])), [0, 0, FINE, 10 * FINE, 800])
        assert not reference.is_over(100)
        assert reference.is_over(101)

    def test_slows_with_errors_and_never_goes_back(self, reference: PathFollowingReference) -> None:
        clock, rows = reference.rewind(), []
        for period in range(100):
            clock.govern(period + 3, np.array([0.1 if period >= 50 else 0.0]))
            rows.append(int(clock.rows_at(period + 3)))
        steps = np.diff(rows)
        assert (steps >= 0).all()
        assert (steps[:45] == FINE).all()
        assert steps[-5:].mean() == pytest.approx(PaceSettings().slowest * FINE, abs=0.5)
        assert reference.clock.passed == [0.0], "another clock of the same path begins at its start"

    def test_what_is_decided_stays(self, reference: PathFollowingReference) -> None:
        clock = reference.rewind()
        clock.govern(5, np.zeros(1))
        before = clock.rows_at(np.arange(6))
        clock.govern(5, np.ones(1))
        np.testing.assert_array_equal(clock.rows_at(np.arange(6)), before)
        assert clock.rows_at(20) < 20 * FINE

    def test_distance_from_the_path_knows_no_lag(self, reference: PathFollowingReference) -> None:
        tips = np.array([[0.30, 0.003, 0.004], [0.50, 0.0, 0.0]])
        np.testing.assert_allclose(contour_errors(reference, np.array([250, 380]), tips), [0.005, 0.0], atol=1e-12)


@pytest.mark.slow
def test_a_closed_loop_with_free_progress(kang: CompiledModel) -> None:
    """A line on the virtual prototype: to its end, near it, in less than the 4 s of its own timing."""
    path = whole_reference(kang, line(40), QUICK)
    rig = SimulatedRig()
    rig.reseed(1)
    done = close_loop(rig, Mpc(kang, path), kang.robot)
    assert done.outcome.solved
    assert done.rows[-1] == len(path) - 1
    loop = ClosedLoop.from_record(done, kang, LoopSetup())
    told = loop.summary()
    assert told["counted_seconds"] < 3.5
    assert told["contour"]["true"]["rms_m"] < 4e-3
    assert told["contour"]["true"]["rms_m"] <= told["errors"]["true"]["rms_m"]
    assert told["reached_s"] == pytest.approx(told["duration_s"], abs=0.05)


def test_points_have_no_progress(kang: CompiledModel) -> None:
    with pytest.raises(InputError, match="no progress"):
        whole_reference(kang, circle(8), replace(QUICK, stay=1.0))

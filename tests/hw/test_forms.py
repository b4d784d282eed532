"""The imperfections' own laws, without a robot: what physics demands of them."""

from itertools import pairwise

import numpy as np
import pytest

from tepm_opt.hw.simulation.imperfections import Imperfections
from tepm_opt.hw.simulation.imperfections.base import Body
from tepm_opt.hw.simulation.imperfections.edges import Prony, StructuralFriction
from tepm_opt.hw.simulation.imperfections.lugre import LuGre
from tepm_opt.hw.simulation.imperfections.pressure import PressureDeadZone, PressureHysteresis, UnequalLag
from tepm_opt.models.robot import load_robot

ROBOT = load_robot("kang2017")


def swing(amplitude: float, cycles: int, steps: int) -> tuple[np.ndarray, float]:
    """Velocities (steps,) in m/s of a sinusoidal motion of one cycle a second, and the step in s."""
    step = cycles / steps
    time = (np.arange(steps) + 0.5) * step
    return 2 * np.pi * amplitude * np.cos(2 * np.pi * time), step


def test_lugre_slides_with_its_friction_and_is_a_spring_before():
    """F = g(v) sign(v) when sliding, σ_0 x before; breakaway above sliding friction."""
    friction = LuGre((1,), 1000.0, breakaway=1.5, stribeck=1e-3)
    for _ in range(1000):
        force = friction.step(np.array([-1e-2]), 0.3, 1e-3)
    assert force[1] == pytest.approx(-0.3)
    for _ in range(1000):
        force = friction.step(np.array([1e-6]), 0.3, 10.0)
    assert force[1] == pytest.approx(0.45, rel=1e-3)
    friction.settle()
    force = friction.step(np.array([1e-3]), 0.3, 1e-2)
    assert force[0] == 0
    assert force[1] == pytest.approx(1000 * 1e-5, rel=0.02)


def test_structural_friction_has_its_breakaway_and_damping():
    """Edges hold with breakaway · F where they creep, slide with F, and feel the bristles' damping as soon as they move."""
    settings = {"sliding_N": 0.3, "breakaway_ratio": 1.5, "stribeck_m_per_s": 1e-3}
    law = StructuralFriction(**settings, bristle_stiffness_N_per_m=1000.0, bristle_damping_N_s_per_m=4.0)
    body = Body.from_robot(ROBOT, 0)
    length = body.rest[:, body.verticals]

    def force(rate: float, duration: float, steps: int) -> np.ndarray:
        stage = law.edge_stage(body)
        for _ in range(steps):
            found = stage.step(length, np.full(length.shape, rate), duration)
        return found[1]

    assert force(1e-6, 10.0, 1000) == pytest.approx(np.full(length.shape, -0.45), rel=1e-3)
    assert force(1e-2, 1e-3, 1000) == pytest.approx(np.full(length.shape, -0.3), rel=1e-3)
    assert force(1e-2, 1e-6, 1) == pytest.approx(np.full(length.shape, -4.0 * 1e-2), rel=1e-2)


def test_lugre_does_not_depend_on_the_tick():
    ends = []
    for ticks in (1, 64):
        friction = LuGre((1,), 1000.0)
        for _ in range(ticks):
            force = friction.step(np.array([2e-3]), 0.3, 0.1 / ticks)
        ends.append(force[1, 0])
    assert ends[0] == pytest.approx(ends[1], rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("amplitude", [1e-5, 1e-3])
def test_friction_and_creep_dissipate_over_closed_cycles(amplitude):
    """Work against the motion over whole cycles is positive once the cycle is steady."""
    velocity, step = swing(amplitude, 4, 8000)
    for law in (LuGre((1,), 5000.0, damping=2.0, breakaway=1.3), Prony(np.full((2, 1, 1), 50.0), np.array([0.3, 3.0]))):
        work = []
        for value in velocity:
            if isinstance(law, LuGre):
                pull = law.step(np.array([value]), 0.2, step)
            else:
                pull = -law.step(np.zeros((1, 1)), np.full((1, 1), value), step)
            work.append(float(pull.mean()) * value * step)
        assert sum(work[4000:]) > 0


def test_play_stack_is_independent_of_rate_and_forgets_inner_loops():
    """The same turning points give the same state, however many ticks lie between; a large loop wipes out small ones."""
    outs = []
    for ticks in (1, 50):
        stage = PressureHysteresis(width_Pa=1e4).pressure_stage(ROBOT)
        stage.settle(np.zeros(1))
        for start, end in ((0, 2e5), (2e5, 1e5), (1e5, 1.2e5), (1.2e5, 0.5e5)):
            path = np.linspace(start, end, ticks + 1)
            for pair in pairwise(path):
                out = stage.step(np.array(pair)[:, None], 1e-3)
        outs.append(out[1, 0])
    assert outs[0] == pytest.approx(outs[1], abs=1e-9)
    assert outs[0] == pytest.approx(0.5e5 + 0.5e4)  # half a width above, all operators having turned


def test_dead_zone_is_smooth_and_zero_at_zero():
    stage = PressureDeadZone(threshold_Pa=2e4, softness_Pa=3e3).pressure_stage(ROBOT)
    pressure = np.linspace(0, 1e5, 1001)
    out = stage.settle(pressure)
    slope = np.gradient(out, pressure)
    assert out[0] == 0
    assert (np.diff(out) > 0).all()
    assert np.interp(2e4, pressure, slope) == pytest.approx(0.5, abs=1e-3)


def test_lag_is_exact_for_linear_set_points_at_any_tick():
    ends = []
    for ticks in (1, 40):
        stage = UnequalLag(0.12, 0.24)
        stage.settle(np.zeros(1))
        path = np.linspace(0, 1e5, ticks + 1)
        for pair in pairwise(path):
            out = stage.step(np.array(pair)[:, None], 0.2 / ticks)
        ends.append(out[1, 0])
    assert ends[0] == pytest.approx(ends[1], rel=1e-12)
    assert ends[0] == pytest.approx(5e5 * (0.2 - 0.12 * (1 - np.exp(-0.2 / 0.12))))


def test_prony_relaxes_nearly_with_the_logarithm_of_time():
    """Between its time constants, spread over decades, the pull after a step falls by equal parts in equal ratios of time."""
    constants = np.array([0.1, 1.0, 10.0, 100.0])
    law = Prony(np.ones((4, 1, 1)), constants)
    law.step(np.zeros((1, 1)), np.full((1, 1), 1e6), 1e-6)
    pulls, time = [], 0.0
    for until in (0.3, 3.0, 30.0):
        pulls.append(-law.step(np.zeros((1, 1)), np.zeros((1, 1)), until - time)[1, 0, 0])
        time = until
    falls = -np.diff(pulls)
    assert falls[0] == pytest.approx(falls[1], rel=0.1)


def test_defaults_are_null():
    """An imperfection with its sizes at zero changes nothing: its stages return what they are given."""
    pressure = np.array([[1e5, 2e5] * 3, [1.1e5, 1e5] * 3])
    for name in ("pressure_hysteresis", "pressure_crosstalk", "actuator_gain"):
        stage = getattr(Imperfections(), name).pressure_stage(ROBOT)
        stage.settle(pressure[0])
        assert stage.step(pressure, 1e-3) == pytest.approx(pressure)
    tension = np.array([np.arange(6.0), np.arange(6.0)])
    for name in ("tendon_slack", "tendon_friction"):
        stage = getattr(Imperfections(), name).tension_stage(ROBOT)
        stage.settle(tension[0], np.full(6, 0.2))
        assert stage.step(tension, np.full(6, 0.2), np.full(6, 0.01), 1e-3) == pytest.approx(tension)

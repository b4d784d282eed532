"""The single-actuator bench: closed forms, friction's band, devices, determinism."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.hw.registry import open_rig
from tepm_opt.hw.rig import Command
from tepm_opt.hw.simulation.bench import BenchRig
from tepm_opt.hw.simulation.rigfile import RigFile
from tests.hw.rigs import AREA, DAMPING, LENGTH, STIFFNESS


def command(pressure: float = 0.0, tension: float = 0.0, enabled: bool = True) -> Command:
    return Command(np.array([pressure]), np.array([tension]), np.array([enabled]))


def bench_with(**sections) -> BenchRig:
    return BenchRig(RigFile.model_validate({"name": "test", "robot": "kang2017", **sections}))


def rest(rig: BenchRig, seconds: float = 2.0) -> float:
    for _ in range(round(100 * seconds)):
        rig.read()
    return float(rig.true_lengths[0])


def test_length_follows_equation_1():
    """L = L_0 + (p A − λ) / K_a, settled or after moving there; 70 mm at 0.5 MPa (III.B); a disabled motor pulls nothing."""
    for pressure, tension in ((0.5e6, 0.0), (0.2e6, 3.0), (0.0, 5.0)):
        expected = LENGTH + (AREA * pressure - tension) / STIFFNESS
        settled, moved = bench_with(), bench_with()
        settled.apply(command(pressure, tension))
        assert settled.read().lengths == pytest.approx([expected], abs=1e-12)
        moved.read()
        moved.apply(command(pressure, tension))
        assert rest(moved) == pytest.approx(expected, abs=1e-9)
        moved.apply(command(pressure, tension, enabled=False))
        assert rest(moved) == pytest.approx(LENGTH + AREA * pressure / STIFFNESS, abs=1e-9)


def test_motion_is_that_of_a_chain_of_masses():
    """Against SciPy's integrator on the written-out equations: six masses, springs and dampers in a row, pushed at the free end."""
    rig = bench_with(tracker={"rate_hz": 1000})
    rig.read()
    rig.apply(command(0.2e6))
    lengths = [float(rig.read().lengths[0]) for _ in range(60)]  # type: ignore[index]
    count, mass, force = 6, 0.22 / 3 / 6, AREA * 0.2e6

    def slope(time: float, state: np.ndarray) -> np.ndarray:
        stretch, rate = (np.diff(part, prepend=0.0) for part in (state[:count], state[count:]))
        pull = count * (STIFFNESS * stretch + DAMPING * rate) - force
        return np.concatenate([state[count:], (np.append(pull[1:], 0.0) - pull) / mass])

    course = solve_ivp(slope, (0.0, 0.061), np.zeros(2 * count), t_eval=1e-3 * np.arange(1, 61), method="Radau", rtol=1e-9, atol=1e-12)
    assert lengths == pytest.approx(LENGTH + course.y[count - 1], abs=1e-8)


@pytest.mark.slow
def test_friction_that_grows_with_the_pull_vanishes_at_rest():
    """Up and down: the loop is twice the share of the elastic force wide, and it closes without residual."""
    slowly = {"fill_s": 0.3, "exhaust_s": 0.3}  # without overshoot
    rig = bench_with(imperfections={"structural_friction": {"share": 0.1}, "regulator_lag": slowly})
    rig.apply(command())
    lengths = {}
    for way, pressures in (("up", (0.1e6, 0.2e6, 0.3e6)), ("down", (0.2e6, 0.0))):
        for pressure in pressures:
            rig.apply(command(pressure))
            lengths[way, pressure] = rest(rig, 4.0)
    force = AREA * 0.2e6
    assert lengths["up", 0.2e6] == pytest.approx(LENGTH + force / 1.1 / STIFFNESS, abs=2e-4)
    assert lengths["down", 0.2e6] == pytest.approx(LENGTH + force / 0.9 / STIFFNESS, abs=2e-4)
    assert lengths["down", 0.0] == pytest.approx(LENGTH, abs=1e-5)


@pytest.mark.slow
def test_same_seed_same_samples_and_another_noise_other_ones():
    rigs = [open_rig("bench") for _ in range(3)]
    rigs[2].simulated.reseed(1)  # type: ignore[union-attr]
    for rig in rigs:
        rig.apply(command(0.2e6))
    first, again, other = ([float(rig.read().lengths[0]) for _ in range(200)] for rig in rigs)  # type: ignore[index]
    assert first == again
    assert first != other
    assert np.std(first) == pytest.approx(np.sqrt(2 / 3) * 1e-3, rel=0.15)


def test_set_points_in_advance_are_the_same_as_one_by_one():
    pressures = np.array([0.0, 0.1e6, 0.3e6, 0.2e6])
    ahead, stepwise = (bench_with(imperfections={"time_delay": {"delay_s": 0.02}, "regulator_lag": {}}) for _ in range(2))
    rows = np.stack([pressures, np.zeros(4)], axis=1)
    for rig in (ahead, stepwise):
        rig.apply(command())
        rig.read()
    ahead.schedule(SetPoints(0.1 * np.arange(4), rows, np.zeros((4, 3))), linear=False)
    for pressure in pressures:
        stepwise.apply(command(pressure))
        for _ in range(10):
            assert ahead.read().lengths == stepwise.read().lengths
    assert ahead.true_lengths[0] > LENGTH + 0.01
    assert ahead.true_nodes[-1, 0, 2] == pytest.approx(ahead.true_lengths[0])


def test_nothing_pushes_the_bench():
    rig = bench_with()
    rig.push(np.zeros(3))
    with pytest.raises(ValueError, match="the bench cannot push"):
        rig.push(np.array([0, 0, 1.0]))
    with pytest.raises(ValueError, match="the bench cannot push"):
        rig.schedule(SetPoints(np.arange(2.0), np.zeros((2, 2)), np.ones((2, 3))))


def test_wrong_commands_are_refused_and_stop_empties():
    rig = bench_with()
    with pytest.raises(ValueError, match="pressure of actuator 11"):
        rig.apply(command(0.6e6))
    with rig:
        rig.apply(command(0.3e6))
        rig.read()
    assert rest(rig) == pytest.approx(LENGTH, abs=1e-9)

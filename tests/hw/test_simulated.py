"""The simulated rig as a controller sees it: time, limits, ENA, determinism; rig files."""

import numpy as np
import pytest

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.hw.registry import open_rig
from tepm_opt.hw.replay import ReplayRig
from tepm_opt.hw.rig import Command
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import builtin_rigs, load_rig_file
from tests.hw.rigs import AREA, LENGTH, STIFFNESS, bar, inputs, ramps, read_until, resting, rig_of


def test_default_rig_is_what_the_specification_fixes():
    """SPEC section 6."""
    file = load_rig_file()
    assert (file.tracker.rate_hz, file.tracker.latency_s, file.tracker.noise_rms_m) == (100, 0.015, 1e-3)
    assert (file.imperfections.regulator_lag.fill_s, file.imperfections.regulator_lag.exhaust_s) == (0.12, 0.24)
    assert (file.stepper.rate_limit_N_per_s, file.imperfections.time_delay.delay_s) == (10.0, 0.005)
    assert file.regulator.step_of(file.nominal) == pytest.approx(4500)
    assert file.stepper.step_of(file.nominal) == pytest.approx(1.05e-3)
    assert set(builtin_rigs()) == {"perfect", "virtual_prototype"}
    assert load_rig_file("perfect").imperfections.active == {}


def test_samples_come_at_the_trackers_rate_and_late():
    """100 Hz, 15 ms old when read; a command given then takes effect 5 ms later: not in the next frame's pose, which is 5 ms older."""
    timing = {"tracker": {"rate_hz": 100, "latency_s": 0.015}, "pressure_monitor": {"fitted": True}}
    rig = bar(sections=timing, time_delay={"delay_s": 0.005})
    times = []
    for _ in range(5):
        times.append((rig.read().time, rig.time))
    assert np.array(times) == pytest.approx(np.array([[0.01 * k, 0.01 * k + 0.015] for k in range(5)]))
    rig.apply(Command.from_inputs(inputs(rig, 0.1e6)))  # at 0.055 s, effective at 0.060 s
    later = [rig.read() for _ in range(3)]
    assert [sample.time for sample in later] == pytest.approx([0.05, 0.06, 0.07])
    assert [float(sample.pressures[0]) for sample in later] == [0, 0, 0.1e6]


def test_first_command_is_where_the_robot_rests():
    """Before time starts it settles, also in later thoughts; after that commands move it."""
    rig = bar()
    assert resting(rig, 0.1e6)[0] == pytest.approx(resting(bar(), 0.1e6)[0], abs=1e-9)
    assert resting(rig, 0.2e6)[0] == pytest.approx(resting(bar(), 0.2e6)[0], abs=1e-9)
    still = [rig.read().points for _ in range(10)]
    assert np.ptp(still, axis=0).max() < 1e-9
    rig.apply(Command.from_inputs(inputs(rig)))
    assert rig.true_lengths[0] == pytest.approx(LENGTH + 0.2e6 * AREA / STIFFNESS, rel=1e-3)
    read_until(rig, 2.0)
    assert rig.true_lengths[0] == pytest.approx(LENGTH, abs=1e-5)


def test_disabled_motors_have_no_tension_and_wind_up_at_their_rate():
    """ENA off: λ = 0 at once. On again: 10 N/s from zero. While on, changes in both directions take their time."""
    rig = bar(sections={"stepper": {"rate_limit_N_per_s": 10.0}, "dynamometer": {"fitted": True}})
    u = inputs(rig, 0.3e6, 2.0)
    on, off = np.ones(3, dtype=bool), np.array([False, True, True])
    rig.apply(Command(u[:3], u[3:], on))
    assert rig.read().tensions == pytest.approx([2, 2, 2])
    rig.apply(Command(u[:3], u[3:], off))
    assert rig.read().tensions == pytest.approx([0, 2, 2])
    read_until(rig, 2.0)
    assert rig.true_lengths - LENGTH == pytest.approx((0.3e6 * AREA - np.array([0, 2, 2])) / STIFFNESS, rel=3e-3)
    rig.apply(Command(u[:3], u[3:], on))
    assert read_until(rig, 2.1)[-1].tensions == pytest.approx([1, 2, 2])
    assert read_until(rig, 2.5)[-1].tensions == pytest.approx([2, 2, 2])
    rig.apply(Command(u[:3], 0.5 * u[3:], on))
    assert rig.read().tensions == pytest.approx([1.9, 1.9, 1.9])


def test_held_and_linear_set_points():
    """The experiment data's convention is linear; holding each row is the other option."""
    for linear, expected in ((True, [0.05e6, 0.1e6, 0.1e6]), (False, [0.0, 0.1e6, 0.1e6])):
        rig = bar(sections={"pressure_monitor": {"fitted": True}})
        rows = np.array([inputs(rig), inputs(rig, 0.1e6), inputs(rig, 0.1e6)])
        rig.schedule(SetPoints(np.array([0, 0.04, 0.08]), rows, np.zeros((3, 3))), linear=linear)
        samples = read_until(rig, 0.08)
        assert [samples[k].pressures[0] for k in (2, 5, 8)] == pytest.approx(expected)


def test_scheduled_tip_force_acts_without_delay():
    rig = bar(time_delay={"delay_s": 0.5})
    force = np.array([[0, 0, 0], [0, 0, 1.0], [0, 0, 1.0]])
    rig.schedule(SetPoints(np.array([0, 0.1, 0.2]), np.array([inputs(rig)] * 3), force))
    read_until(rig, 0.4)
    assert rig.true_lengths - LENGTH == pytest.approx(np.full(3, 1 / (3 * STIFFNESS)), rel=0.01)


def test_real_time_is_an_argument():
    """A clock is waited for sample by sample; it changes nothing else."""
    waits: list[float] = []
    rig = SimulatedRig(bar(sections={"tracker": {"rate_hz": 50, "latency_s": 0.015}}).file, wait=waits.append)
    for _ in range(3):
        rig.read()
    assert waits == pytest.approx([0.015, 0.02, 0.02])


def test_stop_takes_all_away():
    """Leaving the rig, also by an exception, stops it."""
    rig = bar(sections={"pressure_monitor": {"fitted": True}, "dynamometer": {"fitted": True}})
    rig.apply(Command.from_inputs(inputs(rig, 0.1e6, 1.0)))
    rig.read()
    with rig, pytest.raises(ZeroDivisionError):
        raise ZeroDivisionError
    sample = rig.read()
    assert not sample.pressures.any()
    assert not sample.tensions.any()


WRONG = {
    "NaN": (lambda u: u * np.where(np.arange(12) == 2, np.nan, 1), "pressure of actuator 13 = nan Pa; valid: 0 … 500000 Pa"),
    "negative": (lambda u: u - 1, "pressure of actuator 11 = -1 Pa"),
    "too high": (lambda u: u + 6e5 * (np.arange(12) == 4), "pressure of actuator 22 = 600000 Pa; valid: 0 … 500000 Pa"),
    "too tight": (lambda u: u + 8 * (np.arange(12) == 11), "tension of actuator 23 = 8 N; valid: 0 … 7 N"),
    "too few": (lambda u: u[:10], r"pressures has the shape (5,); valid: (6,) for the actuators 11, 12, 13, 21, 22, 23"),
}


@pytest.mark.parametrize(("spoil", "message"), WRONG.values(), ids=WRONG)
def test_wrong_commands_are_refused_and_change_nothing(spoil, message):
    rig = rig_of()
    rig.apply(Command.from_inputs(inputs(rig, 1e5)))
    before = rig.true_points
    with pytest.raises(InputError) as error:
        rig.apply(Command.from_inputs(spoil(inputs(rig))))
    assert message in str(error.value)
    with pytest.raises(InputError):
        rig.schedule(SetPoints(np.arange(2.0), np.array([inputs(rig), np.full(12, np.nan)]), np.zeros((2, 3))))
    np.testing.assert_array_equal(rig.true_points, before)
    with pytest.raises(InputError, match="enabled has to be true or false"):
        rig.apply(Command(np.zeros(6), np.zeros(6), np.ones(6)))


def run_of_prototype(seed: int) -> bytes:
    """Everything a controller sees in a short run of the default rig."""
    rig = SimulatedRig(load_rig_file().model_copy(update={"seed": seed}))
    rig.apply(Command.from_inputs(inputs(rig, 5e4)))
    rig.read()
    rig.apply(Command.from_inputs(inputs(rig, [2e5, 1e5, 0, 0, 1e5, 2e5], 1.0)))
    samples = read_until(rig, 0.2)
    return b"".join(np.concatenate([s.points.ravel(), s.pressures, s.tensions]).tobytes() for s in samples)


def test_same_seed_same_bytes():
    first = run_of_prototype(1)
    assert run_of_prototype(1) == first
    assert run_of_prototype(2) != first


def test_result_does_not_hang_on_the_tick():
    """States of actuators and frictions advanced every 1 ms or every 0.25 ms: the prototype without grids and noise moves the same."""
    file = load_rig_file().model_dump()
    file |= {"tracker": {"rate_hz": 100}, "regulator": {}, "stepper": {"rate_limit_N_per_s": 10.0}}
    ends = []
    for tick in (1e-3, 2.5e-4):
        rig = rig_of(**{key: value for key, value in file.items() if key not in ("name", "robot")} | {"simulation": {"tick_s": tick}})
        ramps(rig, [0, 0.5, 1], [1e5, [2e5, 1e5, 5e4, 5e4, 1e5, 2e5], 1e5], 0.5)
        read_until(rig, 1.0)
        ends.append(rig.true_points)
    assert np.abs(ends[0] - ends[1]).max() < 2e-5


def test_rigs_by_name(tmp_path):
    """`sim`, `sim:FILE`, `replay:FILE`, and clear words for the rest."""
    file = tmp_path / "mine.toml"
    file.write_text('name = "mine"\nrobot = "kang2017"\n[imperfections.payload]\nmass_kg = 0.02\n')
    named = open_rig(f"sim:{file}")
    assert isinstance(named, SimulatedRig)
    assert named.file.imperfections.payload.mass_kg == 0.02
    default = open_rig("sim")
    assert isinstance(default, SimulatedRig)
    assert default.file.name == "virtual prototype"
    for text, message in {
        "sin": "unknown rig 'sin': did you mean 'sim'? valid: bench, bench:FILE, replay:FILE, ros2, ros2:HOST:PORT, serial:PORT, sim",
        "sim:": "nothing stands after the colon; valid: sim, sim:FILE, sim:FILE@ENGINE",
        "replay": "needs the CSV file of a run: replay:FILE",
        "sim:nowhere.toml": "rig 'nowhere.toml' is neither a file nor built in; built in: perfect, virtual_prototype",
        "replay:nowhere.csv": "nowhere.csv: cannot be read",
    }.items():
        with pytest.raises(InputError) as error:
            open_rig(text)
        assert message in str(error.value)
        assert "\n" not in str(error.value)


BAD_FILES = {
    "unknown section": ("[tracer]\nrate_hz = 100\n", "unknown key 'tracer': did you mean 'tracker'? valid:"),
    "unknown imperfection": ("[imperfections.payloads]\nmass_kg = 1\n", "unknown key 'payloads': did you mean 'payload'?"),
    "unknown key": ("[imperfections.creep]\nfracton = 1\n", "unknown key 'fracton': did you mean 'fraction'?"),
    "wrong unit": ("[tracker]\nlatency_s = 15\n", "latency_s = 15"),
    "step too long": ("[simulation]\nstep_s = 0.002\n", "valid: 1e-06 … 0.001 s"),
    "unknown parameter": ("[parameter_factors]\nK = 1.1\n", "unknown parameter 'K'"),
    "too small growth": ("[imperfections.stiffness_hardening]\ngrowth = 1e-9\n", "growth is too small to matter"),
    "no robot": ('robot = "kong"\n', "is neither a file nor built in; built in: four_muscles, hanging, kang2017, one_module, slim"),
}


@pytest.mark.parametrize(("text", "message"), BAD_FILES.values(), ids=BAD_FILES)
def test_wrong_rig_files(tmp_path, text, message):
    path = tmp_path / "rig.toml"
    path.write_text(('name = "x"\n' if "robot" in text else 'name = "x"\nrobot = "kang2017"\n') + text)
    with pytest.raises(InputError) as error:
        load_rig_file(path)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


RECORDING = """time_s,{inputs},tip_force_x_N,tip_force_y_N,tip_force_z_N,{points},tension_11_measured_N,{pressures}
2.00,{zeros},0,0,0,{coordinates},0.5,{measured}
2.05,{zeros},0,0,0,{missing},0.6,{measured}
"""


def recording(folder) -> str:
    """A run of two samples with measured pressures and one measured tension; the tip is lost in the second."""
    names = [f"{h}{j}" for h in (1, 2) for j in (1, 2, 3)]
    coordinates = [f"{0.01 * k:g}" for k in range(12)]
    path = folder / "run.csv"
    path.write_text(RECORDING.format(
        inputs=",".join([f"pressure_{n}_Pa" for n in names] + [f"tension_{n}_N" for n in names]),
        points=",".join(f"s{p}_{axis}_m" for p in (1, 2, 3, 4) for axis in "xyz"),
        pressures=",".join(f"pressure_{n}_measured_Pa" for n in names),
        zeros=",".join(["1000"] * 6 + ["1"] * 6), coordinates=",".join(coordinates), missing=",".join([*coordinates[:9], "", "", ""]),
        measured=",".join(["990"] * 6),
    ))  # fmt: skip
    return str(path)


def test_replay(tmp_path):
    """Rows as samples in their own time; commands are checked only; the end is an end."""
    waits = []
    rig = ReplayRig(recording(tmp_path), wait=waits.append)
    with rig:
        first, second = rig.read(), rig.read()
        rig.apply(Command.from_inputs(np.zeros(12)))
        with pytest.raises(InputError):
            rig.apply(Command.from_inputs(np.full(12, -1.0)))
        with pytest.raises(EOFError, match=r"ended after 2 samples, at 0.050 s"):
            rig.read()
    assert (first.time, second.time, waits) == (0.0, pytest.approx(0.05), [0.0, pytest.approx(0.05)])
    np.testing.assert_array_equal(first.points, np.arange(12).reshape(4, 3) * 0.01)
    assert np.isnan(second.points[3]).all()
    assert (first.status, second.status) == ("ok", "tracker lost s4")
    np.testing.assert_array_equal(first.pressures, np.full(6, 990.0))
    assert first.tensions is None  # one of six is not all
    assert first.extra["tension_11_measured_N"] == 0.5
    np.testing.assert_array_equal(rig.recorded.pressures, np.full(6, 1000.0))
    with pytest.raises(InputError, match="12 inputs and 4 points"):
        open_rig(f"replay:{recording(tmp_path)}", robot=bar().robot)
    (tmp_path / "dataset.toml").write_text(f'name = "x"\nrobot = "{bar().file.robot}"\nsample_rate_hz = 20\nruns = []\n')
    with pytest.raises(InputError, match="12 inputs and 4 points"):
        open_rig(f"replay:{recording(tmp_path)}")

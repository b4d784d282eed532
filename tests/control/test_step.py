"""The predictive controller's step in C against its twin in Python: the same commands, estimates, doubts and columns of the log."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from tepm_opt.control.actuation.pressure_planner import PressurePlannerSettings
from tepm_opt.control.mpc.controller import Mpc, MpcSettings, Use, make_mpc
from tepm_opt.control.mpc.prediction import Weights
from tepm_opt.control.references.reference import Reference, reference_of, sample_tips
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.model import Model
from tepm_opt.solvers.planning.trajectories import lissajous
from tests.control.bench_arm import reference_by_forces
from tests.tools import variant

CLOSE = 1e-9  # N, and m
PLANNED = 3e-7  # N, of later stages: DAQP lets rows of the Python step's program be off by 1e-9 of their length, which is 3e4 at most


@pytest.fixture(scope="module")
def quick(kang: CompiledModel) -> Reference:
    """Back and forth with friction that turns over, too quick for the motors now and then: 4 s."""
    return reference_of(kang, sample_tips(lissajous(400))[0][:400])


@pytest.fixture(scope="module")
def recorded(kang: CompiledModel, quick: Reference, compiler: str) -> list[Sample]:
    """Samples of a closed loop on the virtual prototype, all well."""
    controller, rig, samples = Mpc(kang, quick, MpcSettings(backend="c")), SimulatedRig(), []
    rig.reseed(1)
    rig.apply(controller.start())
    for _ in range(len(quick)):
        samples.append(rig.read())
        rig.apply(controller.command(samples[-1]))
    return samples


def both(model: CompiledModel, reference: Reference, settings: MpcSettings) -> tuple[Mpc, Mpc]:
    """The controller in C and in Python."""
    c, python = (Mpc(model, reference, replace(settings, backend=backend)) for backend in ("c", "python"))
    assert c.is_c
    assert not python.is_c
    return c, python


def compared(
    pair: tuple[Mpc, Mpc], samples: Iterator[Sample], prepares: bool = True, plan: float = PLANNED, close: float = CLOSE
) -> list[Command]:
    """Feeds both with the same samples and checks that they do the same, tensions and frictions within `close`, later stages within
    `plan` in N; the commands."""
    c, python = pair
    commands = []
    for sample in samples:
        found, expected = c.command(sample), python.command(sample)
        if prepares:
            c.prepare(), python.prepare()
        np.testing.assert_allclose(found.tensions, expected.tensions, rtol=0, atol=close)
        np.testing.assert_allclose(found.pressures, expected.pressures, rtol=1e-9)
        assert (found.enabled == expected.enabled).all()
        step, twin = c.last, python.last
        assert (step.period, step.moves, step.outcome.ending) == (twin.period, twin.moves, twin.outcome.ending)
        np.testing.assert_allclose(step.estimate.points, twin.estimate.points, rtol=0, atol=CLOSE)
        np.testing.assert_allclose(step.estimate.friction, twin.estimate.friction, rtol=0, atol=close)
        np.testing.assert_allclose(step.estimate.deviation, twin.estimate.deviation, rtol=0, atol=CLOSE)
        assert (step.estimate.refused == twin.estimate.refused).all()
        np.testing.assert_allclose(step.plan, twin.plan, rtol=0, atol=plan)
        logs = c.telemetry(), python.telemetry()
        assert list(logs[0].columns) == list(logs[1].columns)
        timed = {"program_seconds", "iterations", "program"}
        values = [[value for name, value in log.columns.items() if name not in timed] for log in logs]
        np.testing.assert_allclose(values[0], values[1], rtol=1e-6, atol=1e-8)
        assert logs[0].columns["program"] == logs[1].columns["program"]
        assert (logs[0].doubts, logs[0].fallbacks) == (logs[1].doubts, logs[1].fallbacks)
        commands.append(found)
    return commands


@pytest.mark.slow
def test_the_same_in_closed_loop(kang, quick, recorded):
    """Four seconds with reversals of friction and motors that are as fast as they can."""
    commands = compared(both(kang, quick, MpcSettings()), iter(recorded))
    tensions = np.array([command.tensions for command in commands])
    assert np.abs(np.diff(tensions, axis=0)).max() > 0.099  # 10 N/s
    assert len({tuple(command.pressures) for command in commands}) > 50


@pytest.mark.slow
def test_the_same_where_tensions_meet_their_bounds(kang, quick, recorded):
    """With their middle near 0, from far beside the reference: half of the program's rows are active, its Hessian is nearly singular.

    Later stages of the plan are then determined to some 1e-6 N by it, by either method; what is commanded to some 1e-9 N.
    """
    pair, met = both(kang, quick, MpcSettings(mid_range=0.1)), 0
    for sample in recorded[250:320]:
        compared(pair, iter([sample]), plan=1e-4, close=1e-8)
        met += int((pair[0].last.plan == 0.0).sum())
    assert met > 100


def spoiled(samples: list[Sample], seed: int) -> Iterator[Sample]:
    """Points lost and far off, all of them lost for a while, gauges that lie, are off or are not there, frames lost and given twice."""
    random, zero = np.random.default_rng(seed), samples[0].time
    for k, sample in enumerate(samples):
        if k and (random.random() < 0.03 or 200 <= k < 205):
            continue
        points = sample.points + (2e-3 * random.normal(size=sample.points.shape) if k > 150 else 0.0)  # noisier than declared
        points[random.random(len(points)) < 0.1] = np.nan
        points[random.random(len(points)) < 0.05] += 0.1
        points[:] = np.nan if 100 <= k < 115 else points
        pressures, tensions = np.array(sample.pressures), np.array(sample.tensions)
        tensions[2] -= 0.5
        pressures[random.random(6) < 0.1] = np.nan
        tensions[random.random(6) < 0.1] = np.inf
        late = sample.time + (0.2e-3 * random.normal() if k else 0.0)
        given = Sample(late, points, None if 250 <= k < 300 else pressures, None if 270 <= k < 320 else tensions)
        yield given
        if random.random() < 0.02:
            yield replace(given, time=given.time + 1e-3)
        if k == 350:
            yield replace(given, time=zero)  # from long ago


@pytest.mark.slow
def test_the_same_whatever_is_measured(kang, quick, recorded):
    """Prepared for the next period, which does not always come."""
    pair = both(kang, quick, MpcSettings())
    compared(pair, spoiled(recorded, 0))
    assert {"dynamometer 13", "tracker noise"} <= set(pair[0].telemetry().doubts)


@pytest.mark.slow
def test_the_same_without_the_tip(kang, quick, recorded):
    """The tip is lost for half a second and found again: both become blind, and see again."""
    lost = [replace(sample, points=np.vstack([sample.points[:-1], np.full((1, 3), np.nan)])) for sample in recorded]
    pair = both(kang, quick, MpcSettings())
    compared(pair, iter([*recorded[:30], *lost[30:80]]))
    assert pair[1].last.estimate.seen == 9
    blind = compared(pair, iter(recorded[80:110]))
    seeing = compared(both(kang, quick, MpcSettings()), iter(recorded[:110]))[-30:]
    assert np.abs(blind[0].tensions - seeing[0].tensions).max() > 0.01


@pytest.mark.slow
def test_the_same_without_monitors_or_with_noisy_ones(kang, quick, recorded):
    """Lags are learned from the points, by some regulators or by all."""
    none = [replace(sample, pressures=None) for sample in recorded]
    compared(both(kang, quick, MpcSettings()), iter(none[:150]))
    random = np.random.default_rng(5)
    noisy = [replace(sample, pressures=sample.pressures + np.array([2e4, 0, 0, 2e4, 0, 0]) * random.normal(size=6)) for sample in recorded]
    pair = both(kang, quick, MpcSettings())
    compared(pair, iter(noisy[:150]))
    assert {about for about in pair[0].telemetry().doubts if about.startswith("noise")} == {"noise of monitor 11", "noise of monitor 21"}


@pytest.mark.slow
def test_the_same_with_late_monitors(kang, quick, recorded):
    """Distrusted as soon as they are told, with and without time to prepare."""
    late = [replace(sample, pressures=recorded[max(k - 10, 0)].pressures) for k, sample in enumerate(recorded)]
    for prepares in (True, False):
        pair = both(kang, quick, MpcSettings())
        compared(pair, iter(late[:250]), prepares=prepares)
        assert "pressure monitors" in pair[0].telemetry().doubts


@pytest.mark.slow
def test_the_same_without_time_to_prepare(kang, quick, recorded):
    """All of it when the sample is there; the same commands as prepared."""
    lazy = compared(both(kang, quick, MpcSettings()), iter(recorded[:60]), prepares=False)
    early = compared(both(kang, quick, MpcSettings()), iter(recorded[:60]))
    np.testing.assert_array_equal([command.tensions for command in lazy], [command.tensions for command in early])
    compared(both(kang, quick, MpcSettings()), spoiled(recorded[150:230], 1), prepares=False)


@pytest.mark.slow
def test_the_same_with_late_motors(kang, quick, recorded):
    """Dynamometers that read what was three periods ago: commands act later, which is found out."""
    late = [replace(sample, tensions=recorded[max(k - 3, 0)].tensions) for k, sample in enumerate(recorded)]
    pair = both(kang, quick, MpcSettings())
    compared(pair, iter(late[:120]))
    assert pair[1].ahead > 2
    assert pair[0].ahead == pair[1].ahead


@pytest.mark.slow
def test_the_same_with_other_settings(kang, quick, recorded):
    """Sizes, weights and what the planner does; a horizon beyond the reference's end."""
    planner = PressurePlannerSettings(preview=11, deadband=1.0, quantised=False)
    settings = MpcSettings(stages=8, weights=Weights(tip=2e-3, change=0.3), mid_range=0.3, mid_ranging=False, pressure_planner=planner)
    compared(both(kang, quick, settings), iter(recorded[:40]))
    last = replace(quick, tips=quick.tips[:20], forces=quick.forces[:20], equilibria=quick.equilibria[:20])
    compared(both(kang, last, MpcSettings()), iter(recorded[:40]))


EFFECTS = {
    "maps": {
        "actuator_gain": ("13", {"loss": 0.1}),
        "pressure_crosstalk": (None, {"coupling": 0.02}),
        "tension_gain": ("21", {"loss": 0.05}),
    },
    "memories": {
        "pressure_hysteresis": (None, {"width": 8e3, "distance": 1e4}),
        "tendon_friction": (None, {"constant": 0.2, "share": 0.05}),
    },
    "devices": {"regulator_lag": (None, {"filling_time": 0.05, "exhausting_time": 0.3}), "time_delay": (None, {"delay": 0.02})},
}


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [("maps",), ("memories",), ("devices",), tuple(EFFECTS)], ids=" and ".join)
def test_the_same_with_effects_on_inputs(kinds: tuple[str, ...], recorded, compiler: str) -> None:
    """What a found model has beside the nominal one; nothing of it is in Python only."""
    model = Model.from_robot("kang2017")
    for name, (detail, values) in [each for kind in kinds for each in EFFECTS[kind].items()]:
        model = model.with_effect(name, detail, **values)
    compiled = compile_model(model)
    compared(both(compiled, reference_of(compiled, sample_tips(lissajous(400))[0][:120]), MpcSettings()), iter(recorded[:120]))


ROBOTS = {
    "one module": {"geometry": {"modules": 1}},
    "one module of five": {"geometry": {"modules": 1, "actuator_angles_deg": (0.0, 72.0, 144.0, 216.0, 288.0)}},
    "three light modules": {"geometry": {"modules": 3, "segments_per_module": 2}, "parameters": {"m_d": 0.05}},
}


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
def test_the_same_on_other_robots(robot, compiler):
    """Programs of an odd number of tensions among them; pushed off the reference half way."""
    model = compile_model(Model.from_robot(variant(**ROBOTS[robot])))
    time, muscles = np.linspace(0, 1, 60)[:, None], np.arange(model.layout.inputs // 2)
    reference = reference_by_forces(model, 3 * np.sin(2 * np.pi * time + muscles) * np.minimum(1, 4 * time))
    random, places = np.random.default_rng(0), [at.points for at in reference.equilibria]
    samples = [
        Sample(0.01 * k, at + 8e-4 * random.normal(size=at.shape) + 0.02 * (k > 30)) for k, at in enumerate(places)
    ]  # fmt: skip
    # without monitors the lags' factor is learned, by a factor of the innovations' covariance in C, by a solution in Python; then programs
    # of far references are as near to singular as above
    commands = compared(both(model, reference, MpcSettings()), iter(samples), close=1e-8)
    assert np.ptp([command.tensions for command in commands], axis=0).min() > 0.1


def test_late_steps_go_on_with_the_last_plan(kang, quick, recorded):
    pair = both(kang, quick, MpcSettings(deadline=0.0))
    compared(pair, iter(recorded[:5]))
    assert pair[0].fallbacks == {"late": 5}


@pytest.mark.parametrize("settings", [MpcSettings(stages=1), MpcSettings(use=Use.PRESSURE), MpcSettings(use=Use.TENSION)])
def test_other_settings_step_in_python(kang, quick, settings):
    assert not Mpc(kang, quick, settings).is_c
    with pytest.raises(InputError, match=r"backend 'c': .*; valid: a model in C, both kinds"):
        Mpc(kang, quick, replace(settings, backend="c"))


@pytest.mark.slow
def test_a_model_in_python_steps_in_python(kang_python, kang, short, compiler):
    assert not Mpc(kang_python, short).is_c
    assert repr(Mpc(kang, short)).startswith("Mpc(kang2017 in C, ")


def test_points_of_another_robot(kang, short, compiler):
    with pytest.raises(InputError, match=r"points: shape \(3, 3\); valid: \(4, 3\)"):
        Mpc(kang, short, MpcSettings(backend="c")).command(Sample(0.0, np.zeros((3, 3))))


def test_computing_time_is_a_delay_in_real_time(kang, short):
    """15 ms of age and 5 ms of delay are two periods; with what a step takes they are as many as are whole."""
    assert Mpc(kang, short).ahead == 2
    assert [Mpc(kang, short, MpcSettings(computing=each)).ahead for each in (4e-3, 6e-3, 12e-3)] == [2, 2, 3]
    assert MpcSettings().in_real_time(0.01).computing is None
    assert make_mpc(kang, short, MpcSettings().in_real_time(0.01)).ahead in (2, 3)
    with pytest.raises(InputError, match="computing: None; valid: a time in s"):
        Mpc(kang, short, MpcSettings(computing=None))
    assert Mpc(kang, short, MpcSettings(computing=None), 12e-3).ahead == 3

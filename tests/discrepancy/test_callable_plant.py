"""Machines that a function simulates: derivatives, groups of runs, static data, and the workflow on a plant file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tepm_opt.data.run import Run
from tepm_opt.data.signals import Signals
from tepm_opt.data.tables import write_columns
from tepm_opt.data.trials import read_trials
from tepm_opt.discrepancy.adapters.callable_plant import CallablePlant, Simulator
from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.discrepancy.laws.axis import AXIS
from tepm_opt.discrepancy.laws.effect import Law, Quantity
from tepm_opt.discrepancy.laws.signals import INPUT
from tepm_opt.errors import InputError
from tepm_opt.jobs.discrepancy import run_discrepancy
from tepm_opt.plots.discrepancy import discovery_figures
from tepm_opt.solvers.identification.identify import Problem, identify
from tepm_opt.solvers.mechanics.plant import START, PredictionError

DEAD = Law("dead_zone", "input", (Quantity("width", "signal", 0.0, (0.01, 0.1), 0.0, 1.0),), smooth=False)
LEVER = """
import numpy as np
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.adapters.callable_plant import Simulator
from tepm_opt.discrepancy.laws.effect import Law, Quantity

m = Simulator("a lever on a spring", Signals.from_names(["torque"], ["angle"], "rad"))
m.parameter("compliance", 0.1, "rad/(N m)")
m.effects([Law("dead_zone", "input", (Quantity("width", "signal", 0.0, (0.01, 0.1), 0.0, 1.0),), smooth=False)], "torque", signal=4.0)
m.effects([Law("stiffening", "body", (Quantity("part", "1", 0.0, (0.01, 0.1), -1.0, 1.0),))], "spring")

def simulate(run, values):
    torque, width = run.inputs[:, 0], values["dead_zone[torque].width"]
    angle = values["compliance"] * (torque - np.clip(torque, -width, width))
    return angle * (1 - values["stiffening[spring].part"] * angle**2 / 0.16)

plant = m.plant(simulate, static=True)
"""
MOTOR = Path(__file__).resolve().parents[2] / "examples" / "motor.py"


def run_of(inputs: np.ndarray, outputs: np.ndarray, group: str = "", file: str = "a.csv") -> Run:
    rows = len(inputs)
    return Run(file, "fit", np.full(rows, np.nan), inputs, np.zeros((rows, 3)), outputs, group=group)


def data(folder: Path, files: Mapping[str, Mapping[str, np.ndarray]], noise: str, more: str = "") -> Path:
    folder.mkdir()
    runs = "".join(f'[[runs]]\nfile = "{name}"\nrole = "{"validation" if name.startswith("v") else "fit"}"\n' for name in files)
    (folder / "dataset.toml").write_text(f'name = "made"\n{more}\n[noise]\n{noise}\n{runs}')
    for name, columns in files.items():
        write_columns(folder / name, columns)
    return folder


def plant_file(folder: Path, text: str) -> Path:
    path = folder / "machine.py"
    path.write_text(text)
    return path


def line(run: Run, values: Mapping[str, Any]) -> np.ndarray:
    return values["a"] * run.inputs[:, 0] ** 2 + values["b"]


def parabola(groups: tuple[str, ...] = (), **more: Any) -> CallablePlant:
    m = Simulator("a parabola", Signals.from_names(["u"], ["y"]))
    m.parameter("a", 2.0)
    m.parameter("b", 1.0, std=0.5, groups=groups)
    return m.plant(line, static=True, **more)


def test_derivatives_are_those_of_the_function() -> None:
    run = run_of(np.linspace(0, 3, 7)[:, None], np.zeros((7, 1, 1)))
    found = parabola().predict(run, ["a", "b"])
    assert found.points.shape == (7, 1, 1)
    np.testing.assert_allclose(found.by[0, :, 0, 0], run.inputs[:, 0] ** 2, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.by[1], 1.0, rtol=1e-9)


def test_differences_keep_within_the_range() -> None:
    """The square root of a parameter at its upper and its lower end says nothing beyond them."""
    asked: list[float] = []

    def root(run: Run, values: Mapping[str, float]) -> np.ndarray:
        asked.append(values["a"])
        return np.full(run.rows, np.sqrt(values["a"] * (1 - values["a"])))

    m = Simulator("roots", Signals.from_names(["u"], ["y"]))
    m.parameter("a", 0.5, low=0.0, high=1.0)
    plant, run = m.plant(root, static=True), run_of(np.zeros((1, 1)), np.zeros((1, 1, 1)))
    for end in (0.0, 1.0):
        assert np.isfinite(plant.with_values({"a": end}).predict(run, ["a"]).by).all()
    assert min(asked) >= 0
    assert max(asked) <= 1


def test_many_sets_of_values_at_once_are_one_call() -> None:
    calls = []

    def many(run: Run, values: Mapping[str, np.ndarray]) -> np.ndarray:
        calls.append(len(values["a"]))
        return values["a"][:, None] * run.inputs[:, 0] ** 2 + values["b"][:, None]

    m = Simulator("a parabola", Signals.from_names(["u"], ["y"]))
    m.parameter("a", 2.0)
    m.parameter("b", 1.0, std=0.5)
    run = run_of(np.linspace(0, 3, 7)[:, None], np.zeros((7, 1, 1)))
    found, single = m.plant(many, static=True, many=True).predict(run, ["b", "a"]), parabola().predict(run, ["b", "a"])
    assert calls == [3]
    np.testing.assert_allclose(found.points, single.points)
    np.testing.assert_allclose(found.by, single.by)


def test_states_that_a_run_begins_with() -> None:
    asked = []

    def falling(run: Run, values: Mapping[str, float]) -> np.ndarray:
        height, speed = (0.0, 0.0) if run.state is None else run.state
        asked.append((height, speed))
        return height + speed * run.time - values["g"] / 2 * run.time**2

    m = Simulator("a stone", Signals.from_names([], ["height"], "m"))
    m.parameter("g", 9.8, "m/s2")
    m.state("height", size=1.0)
    m.state("speed", size=5.0)
    time = np.arange(4.0)
    run = Run("a.csv", "fit", time, np.zeros((4, 0)), np.zeros((4, 3)), np.zeros((4, 1, 1)), state=np.array([3.0, 2.0]))
    found = m.plant(falling).predict(run, [f"{START}speed", "g", f"{START}height"])
    np.testing.assert_allclose(found.points.ravel(), 3 + 2 * time - 4.9 * time**2)
    np.testing.assert_allclose(found.by[..., 0, 0], [time, -(time**2) / 2, np.ones(4)], atol=1e-9)
    assert {(3.0, 2.0), (3.001, 2.0), (3.0, 2.005)} == {(round(height, 9), round(speed, 9)) for height, speed in asked}


def test_groups_have_parameters_of_their_own() -> None:
    plant = parabola(("left", "right"))
    assert plant.known == ("a", "b[left]", "b[right]")
    u = np.linspace(0, 3, 7)[:, None]
    runs = tuple(run_of(u, 1.9 * u[:, :, None] ** 2 + b, group, f"{group}.csv") for group, b in (("left", 0.7), ("right", 1.4)))
    right = plant.predict(runs[1], plant.known)
    assert not right.by[1].any()
    assert right.by[2].all()
    found = identify(Problem(plant, runs, plant.free(plant.known), 1e-4)).named
    assert found == pytest.approx({"a": 1.9, "b[left]": 0.7, "b[right]": 1.4}, abs=1e-5)
    with pytest.raises(InputError, match=r"unknown group 'middle'.*valid: left, right"):
        plant.predict(run_of(u, np.zeros((7, 1, 1)), "middle"))


def test_what_a_function_can_get_wrong() -> None:
    run = run_of(np.ones((3, 1)), np.zeros((3, 1, 1)))

    def plant(simulate: Any) -> CallablePlant:
        return Simulator("m", Signals.from_names(["u"], ["y"])).plant(simulate, static=True)

    with pytest.raises(InputError, match=r"outputs of the shape \(1, 2\); valid: \(3, 1, 1\)"):
        plant(lambda run, values: np.zeros(2)).predict(run)
    with pytest.raises(InputError, match=r"outputs of the shape \(1, 3, 2\); valid: \(3, 1, 1\)"):
        plant(lambda run, values: np.zeros((3, 2))).predict(run)
    with pytest.raises(PredictionError, match="not finite"):
        plant(lambda run, values: np.full(3, np.nan)).predict(run)
    with pytest.raises(PredictionError, match="division by zero"):
        plant(lambda run, values: 1 / 0).predict(run)
    with pytest.raises(InputError, match=r"test_callable_plant.py: line \d+: KeyError: 'speed'"):
        plant(lambda run, values: values["speed"]).predict(run)


def test_what_a_plant_file_can_get_wrong() -> None:
    m = Simulator("m", Signals.from_names(["u"], ["y"]))
    m.parameter("a", 2.0)
    with pytest.raises(InputError, match="'a' is there twice"):
        m.parameter("a", 2.0)
    with pytest.raises(InputError, match="outside its range; valid: 0 … 1"):
        m.parameter("b", 2.0, low=0, high=1)
    with pytest.raises(InputError, match=r"dead_zone\[u\] needs the size of 'signal'"):
        m.effects([DEAD], "u")
    lag = next(law for law in (*INPUT, *AXIS) if law.states)
    with pytest.raises(InputError, match=f"{lag.name} has states"):
        m.effects([lag], "u", time=1.0)
    m.effects([DEAD], "u", signal=1.0)
    with pytest.raises(InputError, match="is there twice"):
        m.effects([DEAD], "u", signal=1.0)


def test_static_data_need_no_time_and_points_have_axes(tmp_path: Path) -> None:
    signals = Signals.from_names(["pull"], ["tip"], "m", axes=("x", "y"))
    columns = {"pull": np.arange(3.0), "tip_x": np.arange(3.0), "tip_y": np.array([1.0, np.nan, 3.0])}
    folder = data(tmp_path / "data", {"a.csv": columns}, "tip = 0.1", "static = true")
    run = read_trials(folder, signals, static=True).runs[0]
    assert run.points.shape == (3, 1, 2)
    assert run.points[2].tolist() == [[2.0, 3.0]]
    assert np.isnan(run.time).all()
    with pytest.raises(InputError, match="static = true, but the machine's runs are motions"):
        read_trials(folder, signals)
    (folder / "dataset.toml").write_text((folder / "dataset.toml").read_text().replace("static = true", ""))
    with pytest.raises(InputError, match="column 'time_s' is missing"):
        read_trials(folder, signals)


@pytest.mark.slow
def test_runs_of_a_single_equilibrium(tmp_path: Path) -> None:
    """They are told as if they were rows of one."""
    random, files = np.random.default_rng(3), {}
    for k, torque in enumerate(np.linspace(-4, 4, 48)):
        angle = 0.11 * (torque - np.clip(torque, -0.5, 0.5)) + random.normal(0, 1e-3)
        files[f"{k}.csv"] = {"torque": np.array([torque]), "angle": np.array([angle])}
    folder = data(tmp_path / "data", files, "angle = 1e-3", "static = true")
    found = run_discrepancy(folder, tmp_path / "out", plant=plant_file(tmp_path, LEVER))
    assert [each.candidate.label for each in found.verdict.effects] == ["dead_zone[torque]"], found.verdict.paragraph
    assert found.verdict.effects[0].parameters["width"].value == pytest.approx(0.5, rel=0.05)
    assert len(discovery_figures(found)["over_time"].axes) == 1  # not a panel for each


@pytest.mark.slow
@pytest.mark.parametrize("width", [0.0, 0.5])
def test_a_plain_function_of_equilibria(tmp_path: Path, width: float) -> None:
    random, files = np.random.default_rng(3), {}
    for k, name in enumerate(("a.csv", "b.csv", "c.csv", "d.csv", "v.csv")):
        torque = np.linspace(-4, 4, 400) + 0.03 * k
        angle = 0.11 * (torque - np.clip(torque, -width, width)) + random.normal(0, 1e-3, 400)
        files[name] = {"torque": torque, "angle": angle}
    folder = data(tmp_path / "data", files, "angle = 1e-3", "static = true")
    verdict = run_discrepancy(folder, tmp_path / "out", plant=plant_file(tmp_path, LEVER)).verdict
    if not width:
        assert verdict.status is VerdictStatus.NO_DISCREPANCY, verdict.paragraph
        return
    assert [each.candidate.label for each in verdict.effects] == ["dead_zone[torque]"], verdict.paragraph
    assert verdict.effects[0].parameters["width"].value == pytest.approx(0.5, rel=0.02)
    assert verdict.effects[0].probability > 0.8


@pytest.mark.slow
@pytest.mark.parametrize(("effect", "size"), [("filter[speed]", 0.12), ("dead_zone[voltage]", 0.8)])
def test_a_transfer_function_of_the_control_library(tmp_path: Path, effect: str, size: float) -> None:
    random, files = np.random.default_rng(4), {}
    for name in ("a.csv", "b.csv", "c.csv", "v.csv"):
        time = np.arange(0, 6, 0.02)
        voltage = np.interp(time, np.linspace(0, 6, 13), np.append(0, random.uniform(-10, 10, 12)))
        width = size if effect.startswith("dead") else 0.0
        acts = voltage - np.clip(voltage, -width, width)
        motor, meter = np.exp(-0.02 / 0.33), np.exp(-0.02 / size) if not width else 0.0
        speed, shown = np.zeros(len(time)), np.zeros(len(time))
        for k in range(1, len(time)):  # another integrator: inputs held at their mean from sample to sample
            speed[k] = motor * speed[k - 1] + (1 - motor) * 11.4 * (acts[k - 1] + acts[k]) / 2
            shown[k] = meter * shown[k - 1] + (1 - meter) * (speed[k - 1] + speed[k]) / 2 if meter else speed[k]
        files[name] = {"time_s": time, "voltage": voltage, "speed": shown + random.normal(0, 0.1, len(time))}
    folder = data(tmp_path / "data", files, "speed = 0.1")
    verdict = run_discrepancy(folder, tmp_path / "out", plant=MOTOR).verdict
    assert [each.candidate.label for each in verdict.effects] == [effect], verdict.paragraph
    assert next(iter(verdict.effects[0].parameters.values())).value == pytest.approx(size, rel=0.05)
    assert verdict.recalibrated["gain"].value == pytest.approx(11.4, rel=0.02)

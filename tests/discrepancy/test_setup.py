"""Set-up errors: mistakes made here in the data of a simulated machine, alone and beside a payload."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.adapters.casadi_plant import CasadiPlant
from tepm_opt.discrepancy.adapters.equations import Equations
from tepm_opt.discrepancy.adapters.network import SearchableNetwork
from tepm_opt.discrepancy.setup.check import find_setup_errors
from tepm_opt.models.channels import channels_of
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.effect import ActiveEffect
from tepm_opt.models.model import Model
from tests.discrepancy.small import NOISE, changed, measured, planned, true_values

KNOWN = Model.from_robot("kang2017")
SIGNALS = channels_of(KNOWN.robot).signals
Mistake = Callable[[Run], Run]


def network(model: CompiledModel) -> SearchableNetwork:
    return SearchableNetwork(model, known_model=KNOWN, candidates=(), signals=SIGNALS)


def exchanged(*pairs: tuple[str, str]) -> Mistake:
    """Columns of inputs exchanged, by name without unit."""
    names = [name.rpartition("_")[0] for name in SIGNALS.inputs]
    order = list(range(len(names)))
    for one, other in pairs:
        a, b = names.index(one), names.index(other)
        order[a], order[b] = b, a
    return lambda run: replace(run, inputs=run.inputs[:, order])


def scaled(factor: float, *columns: int) -> Mistake:
    size = np.ones(len(SIGNALS.inputs))
    size[list(columns)] = factor
    return lambda run: replace(run, inputs=run.inputs * size)


def turned(matrix: np.ndarray) -> Mistake:
    return lambda run: replace(run, points=run.points @ matrix.T)


PRESSURES, TENSIONS = range(6), range(6, 12)
MISTAKES: dict[str, tuple[str, Mistake]] = {
    "mirrored": ("mirrored_frame", turned(np.diag([1.0, -1.0, 1.0]))),
    "hoses": ("swapped_inputs", exchanged(("pressure_11", "pressure_12"))),
    "tendons": ("swapped_inputs", exchanged(("tension_21", "tension_23"))),
    "actuators": ("swapped_actuators", exchanged(("pressure_12", "pressure_23"), ("tension_12", "tension_23"))),
    "numbered the other way round": ("renumbered_module", exchanged(("pressure_21", "pressure_23"), ("tension_21", "tension_23"))),
    "x and y": ("swapped_axes", turned(np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]))),
    "a quarter turn": ("rotated_frame", turned(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))),
    "35 degrees": ("rotated_frame", turned(Rotation.from_euler("z", 35, degrees=True).as_matrix())),
    "absolute": ("absolute_pressure", lambda run: replace(run, inputs=run.inputs + np.where(np.arange(12) < 6, 101_325.0, 0.0))),
    "all in psi": ("scaled_channel", scaled(1 / 6894.757, *PRESSURES)),
    "one in kPa": ("scaled_channel", scaled(1e-3, 4)),
    "kgf": ("scaled_channel", scaled(1 / 9.80665, *TENSIONS)),
    "force": ("inverted_force", lambda run: replace(run, tip_force=-run.tip_force)),
    "markers": ("swapped_markers", lambda run: replace(run, points=run.points[:, [0, 2, 1, 3]])),
}
FILES = ("single_pressure.csv", "single_tension.csv", "elongation.csv", "tip_load.csv")


@pytest.fixture(scope="module")
def plain() -> CompiledModel:
    return compile_model(KNOWN)


@pytest.fixture(scope="module")
def healthy(plain: CompiledModel) -> list[Run]:
    return measured(changed(plain, **true_values(plain)), planned(FILES))


@pytest.fixture(scope="module")
def loaded() -> list[Run]:
    """Runs of a machine with a payload of 10 g."""
    heavy = compile_model(replace(KNOWN, effects=(ActiveEffect("payload", None, {"mass": 0.01}),)))
    return measured(heavy, planned(FILES), seed=2)


def found(model: CompiledModel, runs: list[Run]) -> list[str]:
    return [error.kind for error in find_setup_errors(network(model), runs, NOISE)[0]]


@pytest.mark.sample(14)
@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_told_and_its_mend_gives_back_the_data(plain: CompiledModel, healthy: list[Run], name: str) -> None:
    """An angle is found to 2 degrees, which is the tip's place to 15 mm."""
    kind, mistake = MISTAKES[name]
    errors, runs = find_setup_errors(network(plain), [mistake(run) for run in healthy], NOISE)
    kinds = [error.kind for error in errors]
    assert kind in kinds
    assert set(kinds) <= {kind, "swapped_actuators"}  # within a module the same as one numbered otherwise
    assert [error.is_mended for error in errors] == [True] + [False] * (len(errors) - 1)
    for run, before in zip(runs, healthy, strict=True):
        assert run.inputs == pytest.approx(before.inputs, rel=1e-9)
        assert run.tip_force == pytest.approx(before.tip_force)
        assert run.points == pytest.approx(before.points, abs=0.015 if name == "35 degrees" else 1e-12, nan_ok=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_told_beside_a_payload(plain: CompiledModel, loaded: list[Run], name: str) -> None:
    kind, mistake = MISTAKES[name]
    assert kind in found(plain, [mistake(run) for run in loaded])


def test_nothing_is_told_of_a_machine_that_is_set_up_well(plain: CompiledModel, healthy: list[Run]) -> None:
    assert found(plain, healthy) == []


@pytest.mark.slow
def test_nothing_is_told_of_a_payload(plain: CompiledModel, loaded: list[Run]) -> None:
    assert found(plain, loaded) == []


@pytest.mark.slow
@pytest.mark.parametrize("part", [0.5, 0.2, 0.1, 0.0])
def test_a_weak_tendon_is_no_unit(plain: CompiledModel, part: float) -> None:
    """One that lost half of its tension, or all of it, is physics, although a unit explains most of it: 0.2 is nearly N over lbf."""
    runs = planned(FILES)
    inputs = [run.setpoints.inputs * np.where(np.arange(12) == 6, part, 1.0) for run in runs]
    weak = [replace(run, setpoints=replace(run.setpoints, inputs=each)) for run, each in zip(runs, inputs, strict=True)]
    asked = [replace(run, inputs=as_told.setpoints.inputs) for run, as_told in zip(measured(plain, weak), runs, strict=True)]
    assert found(plain, asked) == []


def two_masses() -> CasadiPlant:
    """Two masses on springs with a spring between them, each with a force and a measured place."""
    m = Equations("two masses", time=0.3, laws=())
    (x, v), (y, w) = ((m.state(f"place {k}"), m.state(f"speed {k}")) for k in "12")
    f, g = m.input("force_1", size=1.0), m.input("force_2", size=1.0)
    spring, between = m.parameter("spring", 40.0, "N/m", within=0.2), m.parameter("between", 10.0, "N/m", within=0.2)
    m.rate(x, v)
    m.rate(v, f - spring * x - between * (x - y) - 2.0 * v)
    m.rate(y, w)
    m.rate(w, (g - 2 * spring * y - between * (y - x) - 2.0 * w) / 2.0)
    m.output("place_1", x, "m", size=0.02)
    m.output("place_2", y, "m", size=0.02)
    return m.plant()


@pytest.mark.parametrize(
    ("kind", "channels", "mistake"),
    [
        ("", (), lambda run: run),
        ("swapped_inputs", ("force_1", "force_2"), lambda run: replace(run, inputs=run.inputs[:, ::-1])),
        ("scaled_channel", ("force_2",), lambda run: replace(run, inputs=run.inputs * [1.0, -1.0])),
        ("swapped_markers", ("place_1", "place_2"), lambda run: replace(run, points=run.points[:, ::-1])),
        ("mirrored_frame", ("place_1",), lambda run: replace(run, points=run.points * np.array([[-1.0], [1.0]]))),
    ],
)
def test_a_plant_of_equations(kind: str, channels: tuple[str, ...], mistake: Mistake) -> None:
    """Mistakes of a machine whose springs are 10 % stiffer than known."""
    plant, random, time = two_masses(), np.random.default_rng(4), np.arange(0, 8, 0.02)
    inputs = np.stack([np.sin(2.0 * time), np.sin(3.1 * time + 1) - np.sin(1.0)], axis=1)
    asked = Run("a.csv", "fit", time, inputs, np.zeros((len(time), 3)), np.zeros((len(time), 2, 1)))
    points = plant.with_values({"spring": 44.0}).predict(asked).points
    run = replace(asked, points=points + 2e-4 * random.normal(size=points.shape))
    errors, _ = find_setup_errors(plant, [mistake(run)], 2e-4)
    assert [(error.kind, error.channels) for error in errors] == ([(kind, channels)] if kind else [])


def light_pendulum(stiffness: float = 30.0) -> CasadiPlant:
    """A hardly damped swing, whose frequency is known roughly."""
    m = Equations("swing", time=1.0, laws=())
    q, v, u = m.state("angle"), m.state("rate"), m.input("moment", size=1.0)
    m.rate(q, v)
    m.rate(v, u - m.parameter("stiffness", stiffness, "1/s2", within=0.3) * q - 0.1 * v)
    m.output("angle", q, "rad", size=0.1)
    return m.plant(substeps=2)


@pytest.mark.parametrize(("factor", "kind"), [(1.0, []), (-1.0, ["scaled_channel"])])
def test_a_swing_whose_frequency_is_off_is_fitted_before_it_is_judged(factor: float, kind: list[str]) -> None:
    """At its resonance a stiffness that is off by a sixth leaves more than a third of the motion, with or without the mistake."""
    plant, time, runs = light_pendulum(), np.arange(0, 12, 0.02), []
    for k, random in enumerate(map(np.random.default_rng, range(3))):
        inputs = sum(
            a * (np.sin(w * time + p) - np.sin(p)) for a, w, p in zip((1, 0.7, 0.5), random.uniform(2, 7, 3), (0, 1, 2), strict=True)
        )
        asked = Run(f"{k}.csv", "fit", time, inputs[:, None], np.zeros((len(time), 3)), np.zeros((len(time), 1, 1)))
        points = plant.with_values({"stiffness": 25.0}).predict(asked).points
        runs.append(replace(asked, inputs=factor * asked.inputs, points=points + 1e-3 * random.normal(size=points.shape)))
    errors, _ = find_setup_errors(plant, runs, 1e-3)
    assert [error.kind for error in errors if error.is_mended] == kind

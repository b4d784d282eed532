"""A law that nobody knew: found, written, read back by every command, honest about where it was never asked."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.symbolic.invent import Invention, find_extrapolations, invent
from tepm_opt.discrepancy.symbolic.page import as_json, formula_text, page, paragraph
from tepm_opt.discrepancy.symbolic.responses import simulate_courses
from tepm_opt.discrepancy.symbolic.writing import curve, write
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.effect_files import load_effects, unload_effect
from tepm_opt.models.effects import effects, find_effect
from tepm_opt.models.model import Model, read_model, write_model
from tepm_opt.plots import draw
from tepm_opt.solvers.identification.identify import ParameterEstimate, Problem, identify
from tepm_opt.solvers.mechanics.network_plant import NetworkPlant, free_parameters
from tepm_opt.solvers.mechanics.statics import solve_statics
from tests.discrepancy.small import NOISE, changed, measured, planned, true_values

pytestmark = pytest.mark.slow
FILES = ("single_pressure.csv", "single_tension.csv", "elongation.csv")
BENT = 2e6  # Pa: 22 loses p² / BENT


def weak(model: CompiledModel, files: tuple[str, ...], more: float = 1.0) -> list[Run]:
    """Runs in which 22 loses pressure with its square.

    Args:
        model: of the machine.
        files: which.
        more: times the pressures.
    """
    asked, bent = planned(files), []
    asked = [replace(a, setpoints=replace(a.setpoints, inputs=a.setpoints.inputs * np.repeat([more, 1.0], 6))) for a in asked]
    for each in asked:
        inputs = each.setpoints.inputs.copy()
        inputs[:, 4] -= inputs[:, 4] ** 2 / BENT
        bent.append(replace(each, setpoints=replace(each.setpoints, inputs=inputs)))
    return [replace(run, inputs=each.setpoints.inputs) for run, each in zip(measured(model, bent), asked, strict=True)]


def fitted(kang: CompiledModel, runs: list[Run]) -> ParameterEstimate:
    free = free_parameters(kang, tuple(kang.robot.priors))
    return identify(Problem(NetworkPlant(kang), tuple(runs), free, NOISE, step=0.02, derivatives_apart=0.04))


@pytest.fixture(scope="module")
def true(kang: CompiledModel) -> CompiledModel:
    return changed(kang, **true_values(kang))


@pytest.fixture(scope="module")
def law(kang: CompiledModel, true: CompiledModel, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Invention]:
    judged = weak(true, ("mixed.csv",)) + [replace(run, file="high.csv") for run in weak(true, ("elongation.csv",), 1.3)]
    folder = tmp_path_factory.mktemp("effects")
    found = invent(fitted(kang, weak(true, FILES)), Model.from_robot("kang2017"), folder, "small", judged)
    assert found is not None
    yield found
    unload_effect(found.written.name)


def test_place_formula_and_curve_are_those_of_the_machine(law: Invention, kang: CompiledModel) -> None:
    assert law.formula.place.label == "axial[22](pressure)"
    pressures = np.linspace(0, 3e5, 50)
    truth = -kang.values["A"] * pressures**2 / BENT
    assert np.sqrt(np.mean((curve(law.fitted_formula, pressures) - truth) ** 2)) < 0.1 * np.sqrt(np.mean(truth**2))
    assert law.closes > 0.95
    assert law.errors[1] < 0.5 * law.errors[0]
    assert [f.name for f in law.estimate.problem.free][:4] == list(kang.robot.priors)


def test_what_was_written_is_an_effect_like_others(law: Invention, tmp_path: Path) -> None:
    assert law.file.read_text(encoding="utf-8") == law.written.text
    assert sorted(path.name for path in law.file.parent.glob("*.py")) == [law.file.name]  # what was tried besides has gone
    assert [effect.name for effect in effects() if effect.name.startswith("law_")] == [law.written.name]
    (again,) = load_effects([law.file])
    assert find_effect(law.written.name) is again
    write_model(law.model, tmp_path / "model.toml")
    found = compile_model(read_model(tmp_path / "model.toml"), backend="python")
    inputs = np.append(np.full(6, 2e5), np.zeros(6))
    plant = law.estimate.plant
    assert isinstance(plant, NetworkPlant)
    np.testing.assert_allclose(solve_statics(found, inputs).points, solve_statics(plant.model, inputs).points, atol=1e-8)


def test_it_says_where_it_extrapolates(law: Invention) -> None:
    assert [run.file for run in law.beyond] == ["high.csv"]
    assert law.beyond[0].high == pytest.approx(1.3 * law.beyond[0].visited[1], rel=0.02)
    assert "It extrapolates in high.csv: pressure" in paragraph(law)


def test_a_product_extrapolates_where_either_variable_does(law: Invention, true: CompiledModel) -> None:
    plant = law.estimate.plant
    assert isinstance(plant, NetworkPlant)
    made = simulate_courses(plant, law.estimate.problem.runs)
    judged = [replace(run, file="high.csv") for run in weak(true, ("elongation.csv",), 1.3)]
    product = replace(law.formula, place=replace(law.formula.place, variable="tension", times="pressure"))
    assert [(run.file, run.variable) for run in find_extrapolations(law.estimate, made, product, judged)] == [("high.csv", "pressure")]
    assert not find_extrapolations(law.estimate, made, replace(product, place=replace(product.place, times="")), judged)


def test_it_is_told_and_drawn(law: Invention, tmp_path: Path) -> None:
    told = page(law, "x.png")
    assert formula_text(law) in told
    assert "Pa * (z / 300000) ** 2" in formula_text(law)
    assert "| axial[22](pressure) |" in told
    data = as_json(law)
    assert data["target"] == "22"
    assert data["depends_on"] == "pressure"
    assert list(draw(law, tmp_path)) == [law.written.name]


def test_noise_alone_has_no_law(kang: CompiledModel, true: CompiledModel, tmp_path: Path) -> None:
    runs = measured(true, planned(FILES))
    assert invent(fitted(kang, runs), Model.from_robot("kang2017"), tmp_path, "null") is None
    assert not list(tmp_path.iterdir())


def test_a_data_set_with_an_evil_name_writes_no_program(law: Invention, kang: CompiledModel) -> None:
    evil = 'x"""\nimport os\nos.abort()\n"""'
    text = write(law.formula, kang.layout, 5e-5, evil).text
    assert not [line for line in text.splitlines() if line.strip().startswith(("import os", "os."))]
    assert text == write(law.formula, kang.layout, 5e-5, "x    import os os.abort()").text
    compile(text, "law.py", "exec")

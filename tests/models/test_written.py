"""Functions of models that are kept between runs: read, they are what was written; what changes them is noticed."""

import numpy as np
import pytest

from tepm_opt.models.backends import compiled, written
from tepm_opt.models.backends.compiled import statics_unit, stepping_unit
from tepm_opt.models.compile import compile_model
from tepm_opt.models.dynamics import write_dynamics
from tepm_opt.models.effects import register, unregister
from tepm_opt.models.effects.payload import Payload
from tepm_opt.models.model import Model
from tepm_opt.models.network import write_network
from tests.models.test_compile import SMALL

MODEL = Model.from_robot(SMALL).with_effect("payload").with_effect("regulator_lag")


def kept(folder) -> set[str]:
    """Names of the files of functions in a folder."""
    return {path.name for path in folder.glob(f"*{written.SUFFIX}")}


def test_read_functions_are_the_written_ones(empty_cache) -> None:
    """Same texts, same names, same values of every function at some arguments."""
    for stem, write, unit_of in (("statics", write_network, statics_unit), ("time_stepping", write_dynamics, stepping_unit)):
        (first, text), (again, read) = (written.read_or_write(stem, MODEL, write, unit_of) for _ in range(2))
        assert first is not again
        assert (read, again.parameter_names, again.layout) == (text, first.parameter_names, first.layout)
        for name, function in first.functions.items():
            values = [np.linspace(0.1, 0.2, function.numel_in(k)).reshape(function.size_in(k)) for k in range(function.n_in())]
            results = [np.array(each.call(values)[0]) for each in (function, again.functions[name])]
            assert np.array_equal(*results, equal_nan=True), name
    assert len(kept(empty_cache)) == 2


def test_values_are_not_written(empty_cache) -> None:
    """Models that differ in values of parameters share their functions, whose texts do not depend on them."""
    other = Model.from_robot(SMALL).with_effect("payload", mass=0.11).with_effect("regulator_lag")
    other = other.with_parameters(K_a=1.1 * MODEL.values["K_a"])
    texts = [stepping_unit(write_dynamics(model)).parts for model in (MODEL, other)]
    assert texts[0] == texts[1]
    for model in (MODEL, other):
        written.read_or_write("time_stepping", model, write_dynamics, stepping_unit)
    assert len(kept(empty_cache)) == 1


def test_effects_order_and_sources_count(empty_cache, monkeypatch) -> None:
    """Other effects, and other sources of the package, are other functions."""
    swapped = Model(MODEL.robot, MODEL.parameters, MODEL.effects[::-1])
    for model in (MODEL, swapped, Model.from_robot(SMALL)):
        written.read_or_write("statics", model, write_network, statics_unit)
    assert len(kept(empty_cache)) == 3
    monkeypatch.setattr(written, "_sources", lambda: "other")
    written.read_or_write("statics", MODEL, write_network, statics_unit)
    assert len(kept(empty_cache)) == 4


@pytest.mark.slow
def test_effects_from_elsewhere_are_written_anew(empty_cache) -> None:
    """Nobody knows what code an effect from outside the package depends on."""

    class Load(Payload):
        """Another payload."""

        name = "load_from_elsewhere"

    register(Load())
    try:
        model = Model.from_robot(SMALL).with_effect(Load.name)
        compile_model(model)
    finally:
        unregister(Load.name)
    assert kept(empty_cache) == set()


def test_a_damaged_file_is_written_anew(empty_cache) -> None:
    """The digest in its name tells."""
    written.read_or_write("statics", MODEL, write_network, statics_unit)
    (path,) = empty_cache.glob(f"*{written.SUFFIX}")
    whole = path.read_bytes()
    path.write_bytes(whole[:-100])
    _, texts = written.read_or_write("statics", MODEL, write_network, statics_unit)
    assert texts.symbols == compiled.statics_unit(write_network(MODEL)).symbols
    assert path.read_bytes() == whole


@pytest.mark.slow
@pytest.mark.usefixtures("empty_cache")
def test_kept_models_move_alike(compiler) -> None:
    """A model whose functions were read has the same library and statics as one whose functions were written."""
    first, again = (compile_model(MODEL, backend="c") for _ in range(2))
    u = 0.3 * first.input_max
    assert np.array_equal(first.statics.actuation(u, first.theta), again.statics.actuation(u, again.theta))

"""Models are plain data: they compare, print, pickle, go into a file and come back equal."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tepm_opt.errors import InputError
from tepm_opt.models.compile import compile_model
from tepm_opt.models.effect import ActiveEffect
from tepm_opt.models.model import Model, read_model, write_model
from tepm_opt.models.robot import load_robot, robot_text

NOMINAL = Model.from_robot("kang2017")


def around(value):
    return st.floats(0.5 * value, 2 * value)


@given(
    st.fixed_dictionaries({}, optional={"K_a": around(358.86), "m_d": around(0.22), "alpha_1": st.just(70), "r": around(0.04)}),
    st.one_of(st.none(), st.floats(0, 10)),
    st.one_of(st.none(), st.floats(0, 1e6)),
)
def test_round_trip_is_exact(tmp_path_factory, parameters, mass, threshold):
    model = NOMINAL.with_parameters(**parameters)
    model = model if mass is None else model.with_effect("payload", mass=mass)
    model = model if threshold is None else model.with_effect("pressure_dead_zone", threshold=threshold)
    path = tmp_path_factory.mktemp("model") / "model.toml"
    write_model(model, path)
    back = read_model(path)
    assert back == model
    assert back.values == model.values
    assert pickle.loads(pickle.dumps(model)) == model


def test_models_compare_and_print():
    model = NOMINAL.with_parameters(K_a=350.0).with_effect("payload", mass=0.02)
    assert model != NOMINAL
    assert model != NOMINAL.with_parameters(K_a=351.0).with_effect("payload", mass=0.02)
    assert model != NOMINAL.with_parameters(K_a=350.0).with_effect("payload", mass=0.03)
    assert model == NOMINAL.with_effect("payload", mass=0.02).with_parameters(K_a=350.0)
    for part in ("kang2017", "K_a", "K_a=350", "payload", "0.02"):
        assert part in repr(model)
    with pytest.raises(AttributeError):
        model.effects = ()


def test_they_say_in_one_line_what_they_are():
    model = NOMINAL.with_parameters(K_a=350.0).with_effect("payload", mass=0.02)
    compiled = compile_model(model, backend="python")
    said = {
        "Robot(kang2017: 2 x 3 actuators, 6 segments a module)": model.robot,
        "Model(kang2017: nominal)": NOMINAL,
        "Model(kang2017: K_a=350, payload(mass=0.02, beside_x=0, beside_y=0))": model,
        "CompiledModel(kang2017 in Python: 12 levels, 12 inputs, 13 parameters)": compiled,
    }
    assert [repr(described) for described in said.values()] == list(said)
    for described in (compiled.network, compiled.reference_stepper.dynamics):
        assert repr(described).startswith(f"{type(described).__name__}(12 levels, ")
        assert len(repr(described)) < 120


def test_a_notebook_shows_parameters_and_effects():
    shown = NOMINAL.with_parameters(K_a=350.0).with_effect("payload", mass=0.02)._repr_html_()
    assert "<td>K_a</td><td>350</td><td>N/m</td><td>instead of 358.86</td>" in shown
    assert "<td>payload.mass</td><td>0.02</td><td>kg</td>" in shown
    assert shown.count("<tr>") == 14  # with the head


def test_values_are_the_robots_then_the_effects():
    values = NOMINAL.with_parameters(m_d=0.3).with_effect("payload").values
    own = ["payload.beside_x", "payload.beside_y", "payload.mass"]
    assert list(values) == ["L_0", "r", "A", "m_d", "K_a", "c_a", "alpha_1", "alpha_2", "beta_1", "beta_2", *own]
    assert (values["m_d"], values["L_0"], values["payload.mass"]) == (0.3, 0.2, 0.01)


def test_a_model_file_may_begin_with_a_byte_order_mark(tmp_path):
    model = NOMINAL.with_parameters(m_d=0.3).with_effect("payload")
    write_model(model, tmp_path / "model.toml")
    (tmp_path / "marked.toml").write_text("\ufeff" + (tmp_path / "model.toml").read_text(encoding="utf-8"), encoding="utf-8")
    assert read_model(tmp_path / "marked.toml") == model


def test_a_models_robot_file_is_found_relative_to_the_model_file(tmp_path, monkeypatch):
    for name in ("robots", "models"):
        (tmp_path / name).mkdir()
    (tmp_path / "robots" / "mine.toml").write_text(robot_text("kang2017").replace("m_d = 0.22 ", "m_d = 0.25 "), encoding="utf-8")
    model = Model.from_robot(tmp_path / "robots" / "mine.toml").with_effect("payload")
    write_model(model, tmp_path / "models" / "model.toml")
    assert 'robot = "model.robot.toml"' in (tmp_path / "models" / "model.toml").read_text()
    monkeypatch.chdir(tmp_path / "models")  # where the reader stands does not matter
    for path in ("model.toml", tmp_path / "models" / "model.toml"):
        back = read_model(path)
        assert (back.robot, back.parameters, back.effects) == (model.robot, model.parameters, model.effects)


def test_a_model_file_can_be_moved_with_its_folder(tmp_path):
    """What the robot file was copied from may be gone; one that lies in the folder is not copied."""
    (tmp_path / "mine.toml").write_text(robot_text("kang2017").replace("m_d = 0.22 ", "m_d = 0.25 "), encoding="utf-8")
    model = Model.from_robot(tmp_path / "mine.toml").with_parameters(K_a=350.0)
    (tmp_path / "found").mkdir()
    write_model(model, tmp_path / "found" / "model.toml")
    write_model(model, tmp_path / "beside.toml")
    (tmp_path / "found").rename(tmp_path / "elsewhere")
    (tmp_path / "mine.toml").rename(tmp_path / "robot.toml")
    back = read_model(tmp_path / "elsewhere" / "model.toml")
    assert back == model
    write_model(back.with_parameters(K_a=351.0), tmp_path / "elsewhere" / "model.toml")
    assert sorted(path.name for path in (tmp_path / "elsewhere").iterdir()) == ["model.robot.toml", "model.toml"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["beside.toml", "elsewhere", "robot.toml"]


def test_a_model_whose_robot_is_in_no_file_is_not_written(tmp_path):
    robot = load_robot("kang2017")
    changed = robot.model_copy(update={"parameters": robot.parameters.model_copy(update={"m_d": 0.3})})
    with pytest.raises(InputError, match="differs from 'kang2017'"):
        write_model(Model.from_robot(changed), tmp_path / "model.toml")
    assert list(tmp_path.iterdir()) == []


PAYLOAD = '[[effects]]\nname = "payload"\n'
MALFORMED = {
    "unknown effect": (
        '[[effects]]\nname = "paylod"',
        "unknown effect 'paylod': did you mean 'payload'? valid: ",
    ),
    "unknown parameter": ("[parameters]\nK_b = 1.0", "unknown parameter 'K_b': did you mean 'K_a'? valid: A, K_a, L_0"),
    "parameter out of range": ("[parameters]\nK_a = 1e9", "parameters: K_a = 1000000000.0: input should be less"),
    "text parameter": ('[parameters]\nK_a = "x"', "parameters: K_a = 'x': input should be a valid number; valid: 0 … 100000 N/m"),
    "unknown effect parameter": (PAYLOAD + "parameters = {mas = 1}", "unknown parameter of effect 'payload' 'mas': did you mean 'mass'?"),
    "effect parameter out of range": (PAYLOAD + "parameters = {mass = -1}", "effect 'payload': mass = -1; valid: 0 … 10 kg"),
    "effect parameter in g": (PAYLOAD + "parameters = {mass = 11}", "effect 'payload': mass = 11; valid: 0 … 10 kg"),
    "NaN": (PAYLOAD + "parameters = {mass = nan}", "effect 'payload': mass = nan; valid: 0 … 10 kg"),
    "text effect parameter": (PAYLOAD + 'parameters = {mass = "1"}', "effect 'payload': mass = '1'; valid: 0 … 10 kg"),
    "missing effect parameter": (PAYLOAD, "effect 'payload': parameter 'mass' is missing; it needs: mass"),
    "detail where there is none": (PAYLOAD + 'detail = "23"', "effect 'payload' has no detail, found detail = '23'"),
    "unknown key": ("effect = 1", "unknown key 'effect': did you mean 'effects'? valid: effects, filter, parameters, robot"),
    "unknown noise level": ("[filter]\nfriction_sd = 1.0", "filter: unknown key 'friction_sd': did you mean 'friction_std'? valid: "),
    "noise level out of range": ("[filter]\nstrength_std = 5.0", "filter: strength_std = 5.0: input should be less"),
    "text noise level": (
        '[filter]\nfriction_drift = "1"',
        "filter: friction_drift = '1': input should be a valid number; valid: 0 … 100 N/√s",
    ),
    "unknown key of an effect": (PAYLOAD + "mass = 1", "effects entry 1: unknown key 'mass': "),
    "true for a number": (PAYLOAD + "parameters = {mass = true}", "effect 'payload': mass = True; valid: 0 … 10 kg"),
    "effect twice": (2 * (PAYLOAD + "parameters = {mass = 1}\n"), "effect payload stands twice"),
    "effect without a name": ("[[effects]]\nparameters = {mass = 1}", "effects entry 1: missing key 'name'"),
    "effects not a list": ("effects = 3", "effects = 3: input should be a valid list"),
    "not TOML": ("K_a", "not valid TOML: "),
}


@pytest.mark.parametrize(("text", "message"), MALFORMED.values(), ids=MALFORMED)
def test_malformed_model_files(tmp_path, text, message):
    path = tmp_path / "model.toml"
    path.write_text(f'robot = "kang2017"\n{text}\n')
    with pytest.raises(InputError) as error:
        read_model(path)
    assert str(error.value).startswith(f"{path}: {message}")
    assert "\n" not in str(error.value)


def test_a_model_file_needs_a_robot(tmp_path):
    path = tmp_path / "model.toml"
    for text, message in {
        "": "missing key 'robot'",
        'robot = "kang"': "neither a file nor built in; built in: four_muscles, hanging, kang2017, one_module, slim",
    }.items():
        path.write_text(text)
        with pytest.raises(InputError, match=message) as error:
            read_model(path)
        assert str(error.value).startswith(f"{path}: ")


def test_wrong_models_are_refused_in_code_too():
    with pytest.raises(InputError, match="unknown parameter 'K_b'"):
        NOMINAL.with_parameters(K_b=1.0)
    with pytest.raises(InputError, match="parameters: m_d = -1"):
        NOMINAL.with_parameters(m_d=-1.0)
    with pytest.raises(InputError, match="unknown effect 'nothing'"):
        NOMINAL.with_effect("nothing")
    with pytest.raises(InputError, match="unknown parameter of effect 'payload' 'weight'"):
        NOMINAL.with_effect("payload", weight=1.0)
    with pytest.raises(InputError, match="effect payload stands twice"):
        NOMINAL.with_effect("payload").with_effect("payload")
    with pytest.raises(InputError, match="payload"):
        Model(NOMINAL.robot, effects=(ActiveEffect("payload", None, {"mass": np.inf}),))

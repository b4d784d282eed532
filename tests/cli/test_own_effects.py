"""Effects of one's own in a file: registered for every command, told in a line where something is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tepm_opt.errors import InputError
from tepm_opt.models.effect_files import load_effects, loaded_effects, unload_effect
from tepm_opt.models.effects import effects, find_effect
from tests.cli.conftest import Command

SAG = """
from tepm_opt.models.effect import Effect, Parameter


class SupplySag(Effect):
    name = "supply_sag"
    explains = "the common supply gives way under load"
    reference = "our bench, notes of March"
    parameters = (Parameter("per_pressure", "1/Pa", null=0.0, probe=2e-7, low=0.0, high=2e-6),)

    def inputs(self, pressure, tension, parameters, context):
        mean = sum(pressure[k] for k in range(pressure.numel())) / pressure.numel()
        return pressure * (1 - parameters["per_pressure"] * mean), tension
"""
MODEL = 'robot = "kang2017"\n[[effects]]\nname = "supply_sag"\nparameters = {per_pressure = 1e-6}\n'


@pytest.fixture
def file(tmp_path: Path) -> Iterator[Path]:
    path = tmp_path / "sag.py"
    path.write_text(SAG, encoding="utf-8")
    yield path
    unload_effect("supply_sag")


def test_a_file_adds_its_effects(file: Path) -> None:
    assert loaded_effects() == ""
    (found,) = load_effects([file])
    assert find_effect("supply_sag") is found
    assert [effect.name for effect in effects()] == sorted(effect.name for effect in effects())
    before = loaded_effects()
    file.write_text(SAG.replace("our bench", "his bench"), encoding="utf-8")
    load_effects([file])  # a notebook's cell that is run again
    assert find_effect("supply_sag").reference.startswith("his")
    assert loaded_effects() != before


@pytest.mark.slow
def test_commands_with_a_model_take_it(file: Path, tepm: Command) -> None:
    Path("m.toml").write_text(MODEL, encoding="utf-8")
    asked = "statics", "--pressures", ",".join(["1e5"] * 6), "--model", "m.toml", "--json"
    assert "unknown effect 'supply_sag'" in tepm(*asked).err
    sagging = tepm(*asked, "--effects", str(file))
    assert sagging.status == 0
    nominal = tepm(*asked[:3], "--json")
    assert sagging.json()["tip_m"][0][2] < nominal.json()["tip_m"][0][2] - 1e-3


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "no such Python file"),
        ("import tepm_opt\n", "has no effect; valid: a file with a subclass"),
        ("def f(:\n", r"line 1: SyntaxError"),
        ("\n1 / 0\n", r"line 2: ZeroDivisionError"),
        (SAG.replace('"supply_sag"', '"payload"'), "effect 'payload' exists already"),
        (SAG.replace('"supply_sag"', '"Supply sag"'), "SupplySag: name 'Supply sag'; valid: small letters"),
        (SAG.replace("    reference = ", "    source = "), "SupplySag has no reference"),
        (SAG.replace("    name = ", '    detail = "level"\n    name = '), "detail 'level'; valid: 'actuator', 'point' or None"),
        (SAG.replace("probe=2e-7", "probe=0.0"), "no parameter whose probe differs"),
        (SAG.replace("probe=2e-7", "probe=3e-6"), "parameter 'per_pressure': null 0 or probe 3e-06 outside 0 … 2e-06"),
    ],
)
def test_what_is_wrong_is_told_in_a_line(file: Path, text: str | None, says: str) -> None:
    if text is None:
        file.unlink()
    else:
        file.write_text(text, encoding="utf-8")
    before = effects()
    with pytest.raises(InputError, match=says) as told:
        load_effects([file])
    assert str(told.value).startswith(str(file))
    assert "\n" not in str(told.value)
    assert effects() == before

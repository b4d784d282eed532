"""The exported controller: compiled without Python, it commands what Python does."""

from __future__ import annotations

import dataclasses
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.control.mpc.compiled.export import FILES, export_step
from tepm_opt.control.mpc.controller import Mpc, MpcSettings, Use
from tepm_opt.control.references.reference import Reference
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Sample
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.models.backends.compiler import find_compiler
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.model import Model


@pytest.fixture(scope="module")
def samples(kang: CompiledModel, short: Reference) -> list[Sample]:
    """Of a closed loop, with points and gauges that are lost."""
    controller, rig, found, random = Mpc(kang, short), SimulatedRig(), [], np.random.default_rng(4)
    rig.apply(controller.start())
    for _ in range(150):
        sample = rig.read()
        points, tensions = sample.points.copy(), np.array(sample.tensions)
        points[random.random(4) < 0.1], tensions[random.random(6) < 0.1] = np.nan, np.nan
        found.append(dataclasses.replace(sample, points=points, tensions=tensions))
        rig.apply(controller.command(found[-1]))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("effects", [False, True])
def test_the_same_commands_without_python(
    kang: CompiledModel, short: Reference, samples: list[Sample], tmp_path: Path, compiler: str, effects: bool
) -> None:
    """From the folder alone, without optimisation; commands as those of the step in Python."""
    hysteresis = {"width": 8e3, "distance": 1e4}
    model = compile_model(Model.from_robot("kang2017").with_effect("pressure_hysteresis", **hysteresis)) if effects else kang
    controller = Mpc(model, short, MpcSettings(backend="python"))
    export_step(controller.setup, tmp_path / "exported")
    folder = tmp_path / "exported"
    assert {path.name for path in folder.iterdir()} == set(FILES)
    sources = [str(folder / name) for name in FILES if name.endswith(".c")]
    subprocess.run([*(find_compiler() or ()), "-O1", "-w", "-o", str(folder / "example"), *sources, "-lm"], check=True)
    rows = [[sample.time, *sample.points.ravel(), *sample.pressures, *sample.tensions] for sample in samples]
    text = "\n".join(" ".join(map(repr, map(float, row))) for row in rows)
    done = subprocess.run([str(folder / "example")], input=text, capture_output=True, text=True, check=True)
    found = np.array([line.split() for line in done.stdout.splitlines()], dtype=float)
    commands = []
    for sample in samples:
        commands.append(controller.command(sample))
        controller.prepare()
    np.testing.assert_allclose(found[:, :6], [command.pressures for command in commands], rtol=1e-9)
    np.testing.assert_allclose(found[:, 6:], [command.tensions for command in commands], rtol=0, atol=1e-9)


def test_no_step_in_c_to_export(kang: CompiledModel, short: Reference, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"export: CompiledModel.*; valid: a model in C"):
        export_step(Mpc(kang, short, MpcSettings(use=Use.TENSION)).setup, tmp_path / "nothing")
    assert not (tmp_path / "nothing").exists()

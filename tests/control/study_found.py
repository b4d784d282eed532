"""Does the model of a verdict steer better? `python -m tests.control.study_found FOLDER SEED COUNT [FIRST]` prints a line a machine.

A random machine is recorded (`tepm record standard`), explained (`tepm discrepancy`), and driven on circle and lissajous with the nominal
model, the model found, and that with the filter tuned on one more circle (`tepm tune`). Errors are those of the true tip in mm, rms, mean
of two noises. FOLDER keeps recordings and models, so that an interrupted study goes on.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from tepm_opt.cli import run as tepm
from tepm_opt.hw.simulation.family import random_machine
from tepm_opt.hw.simulation.rigfile import RigFile
from tepm_opt.hw.simulation.rigtext import rig_text
from tepm_opt.jobs.closed_loop import LoopSetup
from tepm_opt.jobs.discrepancy import MODEL, VERDICT, run_discrepancy
from tepm_opt.jobs.mpc import run_closed_loop
from tepm_opt.jobs.tune import run_tune
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.model import read_model
from tests.control.study import prototype, reference
from tests.control.study_tuning import DRIVEN, TASKS, errors


def found_model(file: RigFile, folder: Path) -> CompiledModel:
    """The model that the verdict on a machine's standard recording finds."""
    folder.mkdir(parents=True, exist_ok=True)
    rig, bench, found = folder / "machine.toml", folder / "bench", folder / "found"
    rig.write_text(rig_text(file, "kang2017"))
    if not (bench / "dataset.toml").exists():
        tepm(["record", "standard", "--rig", f"sim:{rig}", "--out", str(bench)])
    if not (found / VERDICT).exists():
        run_discrepancy(bench, found)
    return compile_model(read_model(found / MODEL))


def main(folder: str, seed: str, count: str, first: str = "0") -> None:
    """Print the errors with the three models for each machine."""
    for number in range(int(first), int(first) + int(count)):
        file, own = random_machine("kang2017", int(seed), number), Path(folder) / f"{seed}_{number}"
        known = found_model(file, own)
        with TemporaryDirectory() as loop:
            run_closed_loop(known, reference("circle", known=known), prototype(DRIVEN, file), LoopSetup(), loop)
            tuned = compile_model(run_tune(known, Path(loop)).model)
        each = [errors(file, model) for model in (compile_model("kang2017"), known, tuned)]
        told = "   ".join(f"{task} {' → '.join(f'{one[k]:.2f}' for one in each)}" for k, task in enumerate(TASKS))
        names = [effect["name"] for effect in json.loads((own / "found" / VERDICT).read_text())["effects"]]
        print(f"{seed} {number}: {told}   {', '.join(names)}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Machines with everything at once: `python -m tests.discrepancy.study_machines FOLDER SEED MACHINES [--prototype] [--no-steering]`.

The standard plan is recorded on random machines (`hw.simulation.family`), or on the virtual prototype, and explained; a line a machine says
which of the imperfections that show (own share: what the tip does without it, over the noise) were named, what was named that is not
there, how much of the gap on validation runs closed, and how the circle and the lissajous are followed with the nominal model and with the
one found. Everything is kept in FOLDER: the same command goes on.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from tepm_opt.control.loop import close_loop
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.errors import InputError
from tepm_opt.hw.simulation.family import random_machine
from tepm_opt.hw.simulation.imperfections import Imperfections
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import RigFile, load_rig_file
from tepm_opt.jobs.discrepancy import run_discrepancy
from tepm_opt.jobs.record import RigSource, record
from tepm_opt.models.channels import read
from tepm_opt.models.compile import compile_model
from tepm_opt.models.model import Model, read_model
from tepm_opt.models.robot import load_robot
from tepm_opt.recording.plan import read_plan
from tests.control.study import WIDE, reference

SHOWS = 2.0  # times the noise that an effect must do to the tip to be asked for
BELIEVED = 0.5
ALSO = {  # what an imperfection may rightly be called besides its own name
    "actuator_gain": {"actuator_scatter", "actuator_offset"},
    "uneven_mass": {"mass_distribution", "actuator_offset", "actuator_scatter", "payload", "external_load", "base_tilt"},
}
NOISES = (1, 2)
PLAN = Path(__file__).resolve().parents[2] / "docs" / "plan.toml"


@dataclass
class Told:
    """What came out for a machine; lengths in mm."""

    machine: str
    status: str = ""
    seconds: float = 0.0
    shares: dict[str, float] = field(default_factory=dict)
    named: dict[str, float] = field(default_factory=dict)
    missed: list[str] = field(default_factory=list)
    false: list[str] = field(default_factory=list)
    closed: float = 0.0
    errors: dict[str, float] = field(default_factory=dict)
    steering: dict[str, list[float]] = field(default_factory=dict)


def quiet(file: RigFile) -> RigFile:
    """The same without the tracker's noise."""
    return file.model_copy(update={"tracker": file.tracker.model_copy(update={"noise_rms_m": 0.0})})


def recorded(file: RigFile, folder: Path) -> Path:
    """The standard plan's data set of a rig; what is there is kept."""

    def rig(seed: int) -> SimulatedRig:
        found = SimulatedRig(file)
        found.reseed(seed)
        return found

    record(read_plan(PLAN), folder, RigSource("sim", rig))
    return folder


def shares(file: RigFile, folder: Path) -> dict[str, float]:
    """What the tip does without each imperfection in the place of with it, rms over all runs, over the noise (3-D)."""
    there = {
        name: getattr(file.imperfections, name)
        for name in Imperfections.model_fields
        if getattr(file.imperfections, name).model_dump(exclude_defaults=True)
    }
    whole, found = read(recorded(quiet(file), folder / "with")).usable.runs, {}
    for gone in there:
        less = file.model_copy(update={"imperfections": Imperfections(**{name: each for name, each in there.items() if name != gone})})
        runs = read(recorded(quiet(less), folder / gone)).usable.runs
        moved = np.concatenate([np.linalg.norm(a.points[:, -1] - b.points[:, -1], axis=1) for a, b in zip(whole, runs, strict=True)])
        found[gone] = float(np.sqrt(np.nanmean(moved**2)) / file.tracker.noise_rms_m)
    return found


def steered(file: RigFile, model: Model, task: str) -> float:
    """The true tip's error in mm rms, mean over noises."""
    compiled, found = compile_model(model), []
    path = reference(task, known=compiled)
    for noise in NOISES:
        rig = SimulatedRig(file)
        rig.reseed(noise)
        found.append(1e3 * close_loop(rig, Mpc(compiled, path), model.robot, WIDE).error())
    return float(np.mean(found))


def examined(file: RigFile, folder: Path, steering: bool) -> Told:
    """A machine, from its data on."""
    told = Told(file.name)
    data = recorded(file, folder / "data")
    began = time.monotonic()
    verdict = run_discrepancy(data, folder / "found").verdict
    told.seconds, told.status = time.monotonic() - began, verdict.status.value
    told.named = {e.candidate.label: e.probability for e in verdict.effects}
    told.shares = shares(file, folder / "shares")
    believed = {e.candidate.name for e in verdict.effects if e.probability > BELIEVED}
    meant = {name: {name, *ALSO.get(name, set())} for name in told.shares}
    told.missed = [name for name, share in told.shares.items() if share > SHOWS and not meant[name] & believed]
    wrong = {"parameter"}  # values of the robot file do differ
    told.false = sorted(believed - set().union(*meant.values()) - wrong)
    errors = verdict.errors
    told.closed, told.errors = errors.gap_closed_fraction, {name: 1e3 * value for name, value in asdict(errors).items()}
    if steering:
        models = {"nominal": Model.from_robot(load_robot(file.robot)), "found": read_model(folder / "found" / "model.toml")}
        told.steering = {task: [steered(file, model, task) for model in models.values()] for task in ("circle", "lissajous")}
    return told


def main() -> None:
    """Print a line for every machine, and what all of them come to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("seed", type=int)
    parser.add_argument("machines", type=int)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--prototype", action="store_true")
    parser.add_argument("--no-steering", action="store_true")
    asked = parser.parse_args()
    files = [load_rig_file()] if asked.prototype else []
    files += [random_machine("kang2017", asked.seed, k) for k in range(asked.first, asked.machines)]
    every = []
    for file in files:
        folder = asked.folder / file.name.replace(" ", "_")
        folder.mkdir(parents=True, exist_ok=True)
        kept = folder / "told.json"
        if not kept.exists():
            try:
                kept.write_text(json.dumps(asdict(examined(file, folder, not asked.no_steering))), encoding="utf-8")
            except InputError as error:
                print(f"{file.name}: {error}", flush=True)
                continue
        told = Told(**json.loads(kept.read_text(encoding="utf-8")))
        every.append(told)
        named = ", ".join(f"{name} {p:.2f}" for name, p in told.named.items())
        shown = ", ".join(f"{name} {share:.1f}" for name, share in told.shares.items())
        print(f"{told.machine}: {told.status}, {told.seconds:.0f} s, gap closed {told.closed:.2f}; named {named}", flush=True)
        print(f"    there, times the noise: {shown}", flush=True)
        print(f"    missed {told.missed}, not there {told.false}; mm {told.errors}; mm nominal, found {told.steering}", flush=True)
    asked_for = sum(share > SHOWS for told in every for share in told.shares.values())
    missed, false = (sum(len(getattr(told, name)) for told in every) for name in ("missed", "false"))
    closed = [told.closed for told in every]
    hits = asked_for - missed
    print(f"recall {hits / max(asked_for, 1):.2f}, precision {hits / max(hits + false, 1):.2f}")
    print(f"gap closed {np.median(closed):.2f} in the median, {min(closed):.2f} at worst")


if __name__ == "__main__":
    main()

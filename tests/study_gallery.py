"""The gallery's robots through the whole chain: `python -m tests.study_gallery FOLDER [ROBOT …] [--quick]`.

For each robot: inverse kinematics of the circle in its size, G along it, the motion under these set points, the fastest way over half the
circle's width, the predictive controller round it on the simulated rig; then the standard plan recorded on a machine that is the robot but
for the tracker's noise and a payload of a twentieth of its mass, parameters identified from it, and what is missing named. A table comes at
the end. Everything is kept in FOLDER: the same command goes on. `--quick` leaves out what needs data.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import tepm_opt as tepm
from tepm_opt.hw.registry import open_rig
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import RigFile
from tepm_opt.jobs.discrepancy import VERDICT, run_discrepancy
from tepm_opt.jobs.identify import open_datasets, run_identify
from tepm_opt.jobs.record import RigSource, record
from tepm_opt.solvers.numerics.text import with_deviation

GALLERY = ("one_module", "hanging", "four_muscles", "slim")
SHARE = 0.05  # of the robot's mass, of the hidden payload
SEED = 1
Told = dict[str, Any]


def payload(name: str) -> float:
    """The hidden payload in kg."""
    robot = tepm.load_robot(name)
    return SHARE * robot.modules * robot.parameters.m_d


def hidden(name: str) -> RigFile:
    """A machine that is its robot file but for the tracker's noise and the payload."""
    tracker = tepm.load_robot(name).tracker
    seen = {"rate_hz": tracker.rate_Hz, "noise_rms_m": tracker.noise_rms_m}
    body = {"payload": {"mass_kg": payload(name)}}
    return RigFile.model_validate({"name": "hidden payload", "robot": name, "seed": SEED, "tracker": seen, "imperfections": body})


def steered(name: str, folder: Path) -> Told:
    """What needs no data; lengths in mm."""
    model = tepm.compile_model(name)
    path = tepm.path_for(model, "circle")
    ik = tepm.run_ik(model, path)
    setpoints = ik.setpoints()
    gains = tepm.run_gain(model, setpoints).spans()
    motion = tepm.simulate(model, setpoints).complete()
    middle, across = path.positions.mean(axis=0), (path.positions[0] - path.positions[len(path.positions) // 2]) / 4
    plan = tepm.run_plan(model, ((middle + across).tolist(), (middle - across).tolist()))
    reference = tepm.whole_reference(model, path, tepm.Course())
    loops = {}
    for seed in (SEED, SEED + 1):
        rig = open_rig("sim", model.robot)
        assert rig.simulated is not None
        rig.simulated.reseed(seed)
        loop = tepm.run_closed_loop(model, reference, rig, tepm.LoopSetup(rig="sim", seed=seed))
        loops[seed] = 1e3 * loop.rms(true=True) if loop.ok else float("nan")
    away = np.linalg.norm(path.positions[0] - path.positions.mean(axis=0))
    return {
        "radius": 1e3 * float(away),
        "solved": f"{ik.summary()['solved']} of {len(path.positions)}",
        "rounded": 1e3 * ik.summary()["largest_rounded_tip_error_m"],
        "gains": {kind: [1e3 * value for value in span] for kind, span in gains.items()},
        "open loop": 1e3 * float(np.sqrt(np.mean(np.sum((motion.points[:, -1] - path.positions) ** 2, axis=1)))),
        "plan": plan.summary()["duration_s"] if plan.ok else str(plan.outcome),
        "mpc": loops,
    }


def recorded(name: str, folder: Path) -> Told:
    """The standard plan on the machine with the payload."""
    file, plan = hidden(name), tepm.standard(tepm.Model.from_robot(name)).plan

    def rig(seed: int) -> SimulatedRig:
        found = SimulatedRig(file)
        found.reseed(seed)
        return found

    record(plan, folder / "data", RigSource("payload", rig))
    findings = [f.severity for f in tepm.run_check(folder / "data").findings]
    seconds = sum(float(run.setpoints.time[-1]) for run in plan.runs)
    return {"runs": len(plan.runs), "seconds": seconds, "errors": findings.count("error"), "warnings": findings.count("warning")}


def identified(name: str, folder: Path) -> Told:
    """Parameters of a model without the payload."""
    found = run_identify(tepm.compile_model(name), open_datasets([folder / "data"])).summary()
    bound = [key for key, value in found["parameters"].items() if value["at_bound"]]
    return {"residual over noise": found["residual_over_noise"], "validation": found["validation_rmse_m"], "at bound": bound}


def explained(name: str, folder: Path) -> Told:
    """What the model lacks."""
    path = folder / "found" / VERDICT
    if not path.is_file():
        run_discrepancy(folder / "data", folder / "found")
    verdict = json.loads(path.read_text(encoding="utf-8"))
    return {key: verdict[key] for key in ("status", "effects", "rmse_m")}


QUICK: dict[str, Callable[[str, Path], Told]] = {"steered": steered}
WHOLE = QUICK | {"recorded": recorded, "identified": identified, "explained": explained}


def through(name: str, folder: Path, parts: dict[str, Callable[[str, Path], Told]]) -> Told:
    """Each part of the chain, once; what is there is kept."""
    folder.mkdir(parents=True, exist_ok=True)
    told = {}
    for part, run in parts.items():
        kept = folder / f"{part}.json"
        if not kept.exists():
            kept.write_text(json.dumps(run(name, folder), indent=1), encoding="utf-8")
        told[part] = json.loads(kept.read_text(encoding="utf-8"))
    return told


def rows(name: str, told: Told) -> dict[str, str]:
    """What the table says of a robot, by what it is about."""
    part = told["steered"]
    gains = ", ".join(f"{kind} {low:.0f} … {high:.0f}" for kind, (low, high) in part["gains"].items())
    shown = {
        "circle in its size, radius (mm)": f"{part['radius']:.0f}",
        "`ik`: points solved; tip error on the actuators' grids, largest (mm)": f"{part['solved']}; {part['rounded']:.3f}",
        "`gain`: singular values, full range (mm)": gains,
        "`simulate`: the tip off the circle under these set points in 8 s, rms (mm)": f"{part['open loop']:.1f}",
        "`plan`: fastest way over half the circle's width, from rest to rest (s)": f"{part['plan']:.2f}"
        if isinstance(part["plan"], float)
        else part["plan"],
        "`mpc --rig sim`: true tip, rms (mm), two seeds": ", ".join(f"{value:.2f}" for value in part["mpc"].values()),
    }
    if "recorded" in told:
        data = told["recorded"]
        said = f"{data['errors']} errors, {data['warnings']} warnings"
        shown["`record standard`: runs; duration (s); what `data check` finds"] = f"{data['runs']}; {data['seconds']:.0f}; {said}"
    if "identified" in told:
        found = told["identified"]
        bound = f"; at their bounds: {', '.join(found['at bound'])}" if found["at bound"] else ""
        shown["`identify` without the payload: residual over noise"] = f"{found['residual over noise']:.2f}{bound}"
    if "explained" in told:
        found, true = told["explained"], 1e3 * payload(name)
        named = [f"{e['name']} {e['probability']:.3f}" for e in found["effects"]]
        sizes = [e["parameters"]["mass"] for e in found["effects"] if "mass" in e["parameters"]]
        size = "; ".join(with_deviation(1e3 * each["value"], 1e3 * each["std"]) for each in sizes) or "-"
        errors = found["rmse_m"]
        gap = " → ".join(f"{1e3 * errors[key]:.2f}" for key in ("nominal", "corrected"))
        shown["`discrepancy`: status, effects with their probability"] = f"{found['status']}: {', '.join(named) or 'nothing'}"
        shown["size found, one sigma; true (g)"] = f"{size}; {true:.1f}"
        shown["error on validation runs before and after; noise (mm)"] = f"{gap}; {1e3 * errors['noise_floor']:.2f}"
    return shown


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("robots", nargs="*", default=GALLERY)
    parser.add_argument("--quick", action="store_true")
    asked = parser.parse_args()
    table = {name: rows(name, through(name, asked.folder / name, QUICK if asked.quick else WHOLE)) for name in asked.robots}
    print(f"| | {' | '.join(f'`{name}`' for name in table)} |")
    print(f"| --- |{' --- |' * len(table)}")
    for about in dict.fromkeys(about for each in table.values() for about in each):
        print(f"| {about} | {' | '.join(each.get(about, '') for each in table.values())} |")


if __name__ == "__main__":
    main()

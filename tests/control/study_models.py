"""Does a better model steer better? `python -m tests.control.study_models FOLDER [WHAT …] [--pairs] [--seeds N]` prints a line for each.

Of every imperfection of the virtual prototype the library's effect is fitted to a machine that has nothing but that (`fitted`, kept in
FOLDER); the controller then follows the circle on the prototype with that imperfection alone (and its devices), with the nominal model and
with the fitted one. Pairs and "all" take the fits together.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from tepm_opt.control.loop import close_loop
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.control.references.reference import reference_of
from tepm_opt.hw.simulation.imperfections import Imperfections
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import RigFile, load_rig_file
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.model import Model
from tepm_opt.models.robot import load_robot
from tepm_opt.solvers.identification.identify import Problem, identify
from tepm_opt.solvers.mechanics.network_plant import NetworkPlant
from tepm_opt.studies.blind.excitation import excitations
from tepm_opt.studies.blind.machine import Deviation, rig_file, simulate_run
from tests.control.study import WIDE, reference

ROBOT = load_robot("kang2017")
PARAMETERS, UNEVEN = "parameters", "uneven_mass"
LIBRARY = ("actuator_gain", "structural_friction", "tendon_friction", "pressure_hysteresis", "rigid_plates", "mass_distribution")
WHATS = (PARAMETERS, *LIBRARY, UNEVEN)
NOISE, SEED = 2e-4, 4711


def alone(whats: Sequence[str]) -> RigFile:
    """The prototype with its devices and some of its imperfections."""
    file = load_rig_file()
    devices = {name: getattr(file.imperfections, name) for name in ("time_delay", "regulator_lag")}
    kept = {name: getattr(file.imperfections, name) for name in whats if name != PARAMETERS}
    factors = file.parameter_factors if PARAMETERS in whats else {}
    return file.model_copy(update={"imperfections": Imperfections(**{**devices, **kept}), "parameter_factors": factors})


def fitted(what: str, folder: Path) -> Model:
    """The model of the prototype with one imperfection: the library's effect with what fits best."""
    path, known = folder / f"{what}.json", Model.from_robot(ROBOT)
    if what == PARAMETERS:
        values = known.robot.parameters.model_dump()
        factors = {name: factor for name, factor in dict(load_rig_file().parameter_factors).items() if factor != 1.0}
        return Model(ROBOT, {name: values[name] * factor for name, factor in factors.items()})
    if what == UNEVEN:
        return known  # no effect of the library is that
    details = (None,) if what != "actuator_gain" else tuple(compile_model(known).layout.actuator_names)
    for detail in details:
        known = known.with_effect(what, detail)
    if not path.exists():
        found = load_rig_file().imperfections
        hidden = Deviation({what: getattr(found, what).model_dump(exclude_defaults=True)})
        runs = [simulate_run(rig_file(ROBOT, hidden, NOISE, SEED), hidden, run, k + 1) for k, run in enumerate(excitations(SEED, True))]
        plant = NetworkPlant(compile_model(known))
        names = [name for name in plant.values if "." in name]
        estimate = identify(Problem(plant, tuple(runs), plant.free(names), NOISE, step=0.02, derivatives_apart=0.04))
        path.write_text(json.dumps({"noises": float(np.sqrt(estimate.cost / estimate.count)), **estimate.named}), encoding="utf-8")
    values = json.loads(path.read_text(encoding="utf-8"))
    effects = tuple(
        replace(e, parameters={name: values.get(f"{e.label}.{name}", value) for name, value in e.parameters.items()}) for e in known.effects
    )
    return replace(known, effects=effects)


def together(models: Sequence[Model]) -> Model:
    """All effects and parameters of some models at once."""
    parameters = {name: value for model in models for name, value in model.parameters.items()}
    return Model(ROBOT, parameters, tuple(effect for model in models for effect in model.effects))


def error(file: RigFile, model: CompiledModel, seeds: Sequence[int], task: str = "circle") -> float:
    """Root mean square of the true tip's error in mm, mean over noises."""
    asked, found = reference(task), []
    path = reference_of(model, asked.tips, asked.counted, asked.point)
    for seed in seeds:
        rig = SimulatedRig(file)
        rig.reseed(seed)
        found.append(1e3 * close_loop(rig, Mpc(model, path), ROBOT, WIDE).error())
    return float(np.mean(found))


def main() -> None:
    """Print a line for every imperfection, pair or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("what", nargs="*", help="only these, or 'all'")
    parser.add_argument("--pairs", action="store_true")
    parser.add_argument("--seeds", type=int, default=2)
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    groups = [(what,) for what in WHATS] + (list(combinations(WHATS, 2)) if options.pairs else []) + [WHATS]
    if options.what:
        groups = [WHATS if what == "all" else tuple(what.split("+")) for what in options.what]
    nominal = compile_model(Model.from_robot(ROBOT))
    for group in groups:
        file, better = alone(group), compile_model(together([fitted(what, options.folder) for what in group]))
        seeds = range(31, 31 + options.seeds)
        before, after = error(file, nominal, seeds), error(file, better, seeds)
        name = "all" if group == WHATS else "+".join(group)
        print(f"{'ok   ' if after <= 1.05 * before else 'WORSE'} {name:45s} {before:6.3f} {after:6.3f}", flush=True)


if __name__ == "__main__":
    main()

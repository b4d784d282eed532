"""Static pulls of a tapered silicone tentacle (`real/soromox_tendon_tentacle`), each file one equilibrium.

python examples/measured_tentacle.py DATA_SET

prints how far the markers of each pull are from where a fit to all the others has them, and how much of what a fit to all of them leaves
any smooth law of the tensions could predict.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.data.tables import write_columns
from tepm_opt.data.trials import read_trials
from tepm_opt.jobs.plants import load_plant
from tepm_opt.solvers.identification.identify import Problem, identify
from tepm_opt.solvers.mechanics.plant import Plant

PULLEY = 0.0325  # m, from the motors' torques to tensions
SETTLED = 40  # samples at the end of a recording
NOISE = 1e-3  # m, to which pulls of one mounting repeat
BOTH = {"00050010": (0.05, 0.1), "001": (0.1, 0.1), "00100005": (0.1, 0.05), "001002": (0.1, 0.2), "0015002": (0.15, 0.2),
        "002": (0.2, 0.2), "002001": (0.2, 0.1), "0020015": (0.2, 0.15)}  # fmt: skip
MARKERS = ("p1", "p2", "p3", "p4")
SECOND = 0.235  # m: the base marker is at 0.217 m along the cameras' x in one mounting, at 0.248 m in the other


def torques(name: str) -> tuple[float, float]:
    """Torques of the motors in N m, from a file's name."""
    motor, level = name.removesuffix(".csv").split("_u")
    if motor == "m12":
        return BOTH[level]
    torque = float(f"0.{level[1:]}")
    return (torque, 0.0) if motor == "m1" else (0.0, torque)


def tentacle(shared: Path, out: Path) -> None:
    """Tensions in N and the markers seen from the one at the base in m, z (the cameras' y) down; the mounting as the group."""
    source = shared / "real" / "soromox_tendon_tentacle"
    order = json.loads((source / "marker_order.json").read_text(encoding="utf-8"))
    out.mkdir(parents=True, exist_ok=True)
    lines = ['name = "tentacle"', "static = true", "runs = ["]
    for name in sorted(order):
        settled = np.genfromtxt(source / name, delimiter=",")[-SETTLED:, 2:].reshape(SETTLED, 5, 3).mean(axis=0)
        base, *markers = settled[[order[name][marker] for marker in ("pb", *MARKERS)]]
        columns = {f"tension_{k + 1}": np.array([torque / PULLEY]) for k, torque in enumerate(torques(name))}
        for marker, at in zip(MARKERS, markers - base, strict=True):
            columns |= {f"{marker}_{axis}": at[[k]] for axis, k in (("x", 2), ("y", 0), ("z", 1))}
        write_columns(out / name, columns)
        lines.append(f'  {{ file = "{name}", role = "fit", group = "{"first" if base[0] < SECOND else "second"}" }},')
    lines += ["]", "[noise]", *(f"{marker} = {NOISE}" for marker in MARKERS)]
    (out / "dataset.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def left_out(plant: Plant, runs: tuple[Run, ...], known: tuple[str, ...]) -> np.ndarray:
    """Distances of markers, (runs, markers) in m, from where fits to all other runs have them, each from the same first values."""
    found = []
    for run in runs:
        rest = tuple(other for other in runs if other is not run)
        fit = identify(Problem(plant, rest, plant.free(known), NOISE), 60)
        if not fit.solved:
            raise RuntimeError(f"without {run.file}: {fit.outcome}")
        found.append(np.linalg.norm(fit.plant.predict(run).points - run.points, axis=-1).mean(axis=0))
    return np.array(found)


def smooth_part(plant: Plant, runs: Sequence[Run], known: Sequence[str]) -> tuple[float, float]:
    """Mean marker error in m of a fit to all runs, and with the residuals of left-out runs predicted by a Gaussian process of the tensions.

    The best of many length scales and noises counts, and the fit has seen all runs: both flatter the process. A law of the tensions that
    the data carry would show as a residual that neighbouring pulls share.
    """
    fit = identify(Problem(plant, tuple(runs), plant.free(known), NOISE), 60)
    left = np.array([(run.points - fit.plant.predict(run).points).ravel() for run in runs])
    tensions = np.array([run.inputs[0] for run in runs])
    tensions = tensions / tensions.max(axis=0)

    def error(of: np.ndarray) -> float:
        return float(np.linalg.norm(of.reshape(len(runs), -1, 3), axis=-1).mean())

    least = np.inf
    for scales in product((0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 5.0), repeat=2):
        square = (((tensions[:, None] - tensions) / scales) ** 2).sum(axis=-1)
        for noise in (0.01, 0.03, 0.1, 0.3, 1.0, 3.0):
            inverse = np.linalg.inv(np.exp(-square / 2) + noise * np.eye(len(runs)))
            least = min(least, error(inverse @ left / np.diag(inverse)[:, None]))  # Sundararajan and Keerthi 2001
    return error(left), least


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    machine = load_plant(Path(__file__).parent / "tentacle.py")
    pulls = read_trials(sys.argv[1], machine.signals, static=True).runs
    errors = 1e3 * left_out(machine, pulls, machine.known)
    for pull, each in zip(pulls, errors, strict=True):
        print(f"{pull.file:20} {' '.join(f'{error:5.1f}' for error in each)} mm")
    told, smooth = smooth_part(machine, pulls, machine.known)
    print(
        f"of a fit to all pulls {1e3 * told:.2f} mm; with what a smooth law of the tensions predicts of its residuals {1e3 * smooth:.2f} mm"
    )
    print(f"mean marker error of pulls left out: {errors.mean():.2f} mm")

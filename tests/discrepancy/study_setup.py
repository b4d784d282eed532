"""How often mistakes of set-up are told, and whether any is told where there is none.

`python -m tests.discrepancy.study_setup robot FOLDER [N]` makes N random mistakes in each data set of FOLDER, in turn, and looks at each
without one; `tepm study blind --data FOLDER` writes such data sets. `… network [N [SEED]]` simulates N robots that are the model, every
other one with an effect; `… plants [N [SEED]]` a two-link arm and a trunk, each alone and beside an effect. Prints a line for every
wrong answer and, last, the rates.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tepm_opt.data.noise import noise_of
from tepm_opt.data.run import Run
from tepm_opt.discrepancy.adapters.network import SearchableNetwork
from tepm_opt.discrepancy.problem.plant import SearchablePlant
from tepm_opt.discrepancy.setup.check import find_setup_errors
from tepm_opt.jobs.discrepancy import checked_dataset
from tepm_opt.jobs.plants import load_plant
from tepm_opt.models.channels import channels_of
from tepm_opt.models.model import Model
from tepm_opt.solvers.mechanics.plant import PredictionError
from tests.discrepancy.small import NOISE as SMALL
from tests.discrepancy.small import planned

Mistake = tuple[str, Callable[[Run], Run]]
EXAMPLES = Path(__file__).parents[2] / "examples"
TURNED = [1, 2, 0, 3, 4, 5, 7, 8, 6, 9, 10, 11]
NOISE = {"two-link arm": 2e-4, "trunk": 2e-4}  # rad, m


def order_inputs(count: int, *pairs: tuple[int, int]) -> Callable[[Run], Run]:
    order = list(range(count))
    for a, b in pairs:
        order[a], order[b] = b, a
    return lambda run: replace(run, inputs=run.inputs[:, order])


def scale_inputs(count: int, columns: list[int], factor: float) -> Callable[[Run], Run]:
    scale = np.ones(count)
    scale[columns] = factor
    return lambda run: replace(run, inputs=run.inputs * scale)


def frame(matrix: np.ndarray) -> Callable[[Run], Run]:
    return lambda run: replace(run, points=run.points @ np.asarray(matrix).T)


def order_points(order: list[int]) -> Callable[[Run], Run]:
    return lambda run: replace(run, points=run.points[:, order])


def frames() -> dict[str, Mistake]:
    """Frames of a tracker that are not those of the model."""
    found: dict[str, Mistake] = {
        f"mirror {axis}": ("mirrored_frame", frame(np.diag([1.0 - 2.0 * (k == at) for k in range(3)]))) for at, axis in enumerate("xyz")
    }
    for a, b in combinations(range(3), 2):
        matrix = np.eye(3)
        matrix[[a, b]] = matrix[[b, a]]
        found[f"axes {'xyz'[a]} {'xyz'[b]}"] = ("swapped_axes", frame(matrix))
    turns = (("z", 90), ("z", -120), ("z", 35), ("x", 90), ("y", 90), ("y", 180))
    turned = {f"turn {axis} {angle}": Rotation.from_euler(axis, angle, degrees=True).as_matrix() for axis, angle in turns}
    return found | {name: ("rotated_frame", frame(matrix)) for name, matrix in turned.items()}


def robot_mistakes() -> dict[str, Mistake]:
    """Mistakes around a robot of two modules of three actuators with four points."""
    swap, pressures, tensions = (lambda *pairs: order_inputs(12, *pairs)), list(range(6)), list(range(6, 12))
    return {
        **{f"hoses {a} {b}": ("swapped_inputs", swap((a, b))) for a, b in ((0, 1), (2, 3), (4, 5))},
        **{f"tendons {a} {b}": ("swapped_inputs", swap((a, b))) for a, b in ((6, 8), (9, 10), (7, 10))},
        **{f"actuators {a} {b}": ("swapped_actuators", swap((a, b), (a + 6, b + 6))) for a, b in ((0, 1), (1, 5), (4, 5))},
        "first module turned": (
            "renumbered_module",
            lambda run: replace(run, inputs=run.inputs[:, [1, 2, 0, 3, 4, 5, 7, 8, 6, 9, 10, 11]]),
        ),
        "second module reversed": ("renumbered_module", swap((3, 5), (9, 11))),
        **{name: mistake for name, mistake in frames().items() if name != "turn y 180"},
        "absolute": ("absolute_pressure", lambda run: replace(run, inputs=run.inputs + np.repeat([101_325.0, 0.0], 6))),
        "psi": ("scaled_channel", scale_inputs(12, pressures, 1 / 6894.757)),
        "one in psi": ("scaled_channel", scale_inputs(12, [4], 1 / 6894.757)),
        "one in kPa": ("scaled_channel", scale_inputs(12, [2], 1e-3)),
        "kgf": ("scaled_channel", scale_inputs(12, tensions, 1 / 9.80665)),
        "one in kgf": ("scaled_channel", scale_inputs(12, [9], 1 / 9.80665)),
        "points 1 2": ("swapped_markers", order_points([1, 0, 2, 3])),
        "points 3 4": ("swapped_markers", order_points([0, 1, 3, 2])),
    }


def plant_mistakes(plant: SearchablePlant) -> dict[str, Mistake]:
    """Mistakes around a machine whose inputs are of one kind: exchanged and reversed inputs, points or frames."""
    count, points = len(plant.signals.inputs), len(plant.signals.points)
    found = {f"inputs {a} {b}": ("swapped_inputs", order_inputs(count, (a, b))) for a, b in combinations(range(count), 2)}
    found |= {f"input {k} reversed": ("scaled_channel", scale_inputs(count, [k], -1.0)) for k in range(count)}
    found["all reversed"] = ("scaled_channel", scale_inputs(count, list(range(count)), -1.0))
    if len(plant.signals.axes) == 3:
        return found | frames()
    for a, b in combinations(range(points), 2):
        found[f"points {a} {b}"] = ("swapped_markers", order_points([b if k == a else a if k == b else k for k in range(points)]))
    for k in range(points):
        sign = np.where(np.arange(points) == k, -1.0, 1.0)[:, None]
        found[f"point {k} reversed"] = ("mirrored_frame", lambda run, sign=sign: replace(run, points=run.points * sign))
    return found


@dataclass
class Rates:
    """Right and all answers by case, and the longest time of one.

    Attributes:
        right, asked: numbers of answers by case.
        longest: time of one in s.
    """

    right: Counter[str] = field(default_factory=Counter)
    asked: Counter[str] = field(default_factory=Counter)
    longest: float = 0.0

    def judge(self, case: str, name: str, plant: SearchablePlant, runs: list[Run], noise: float | np.ndarray, kind: str) -> None:
        """Ask for set-up errors and note whether the answer is this kind; none where it is empty."""
        began = time.monotonic()
        found, _ = find_setup_errors(plant, runs, noise)
        self.longest = max(self.longest, time.monotonic() - began)
        right = kind in [error.kind for error in found] if kind else not found
        self.asked[case] += 1
        self.right[case] += right
        if not right:
            print(f"{name}: {kind or 'nothing'} is {found}", flush=True)

    def show(self) -> None:
        for case, asked in self.asked.items():
            print(f"{case}: {self.right[case]} of {asked}")
        print(f"at most {self.longest:.1f} s")


def study_robot(folder: Path, each: int, seed: int = 0) -> Rates:
    """Mistakes in data sets of a robot, some with a hidden effect."""
    rates, random, mistakes = Rates(), np.random.default_rng(seed), robot_mistakes()
    names = cycle(random, list(mistakes))
    plants: dict[str, SearchablePlant] = {}
    for path in sorted(folder.glob("*/dataset.toml")):
        dataset, _ = checked_dataset(path.parent, despite_errors=True)
        known = Model.from_robot(dataset.robot)
        plant = plants.setdefault(dataset.robot, SearchableNetwork.of_known(known, channels_of(known.robot)))
        noise = noise_of(dataset)
        rates.judge("no mistake", path.parent.name, plant, list(dataset.runs), noise, "")
        for name in (next(names) for _ in range(each)):
            kind, spoil = mistakes[name]
            rates.judge("mistake", f"{path.parent.name} {name}", plant, [spoil(run) for run in dataset.runs], noise, kind)
    return rates


def study_network(count: int, seed: int = 0) -> Rates:
    """Mistakes around a robot that is the model but for its parameters and, every other time, an effect."""
    rates, random, mistakes, known = Rates(), np.random.default_rng(seed), robot_mistakes(), Model.from_robot("kang2017")
    plant, names = SearchableNetwork.from_model(known, channels_of(known.robot)), cycle(random, list(mistakes))
    for k in range(count):
        asked = [
            Run(e.file, e.role, e.setpoints.time, e.setpoints.inputs, e.setpoints.tip_force, np.zeros((len(e.setpoints.time), 4, 3)))
            for e in planned(seed=k)
        ]
        values = draw_effect(plant, random, asked[-1]) if k % 2 else {}
        true, case = plant.with_values(draw_known(plant, random) | values), "beside an effect" if values else "alone"
        runs = [replace(run, points=true.predict(run).points + SMALL * random.normal(size=run.points.shape)) for run in asked]
        rates.judge(f"no mistake, {case}", f"network {k} {list(values)}", plant, runs, SMALL, "")
        kind, spoil = mistakes[name := next(names)]
        rates.judge(case, f"network {k} {name} {list(values)}", plant, [spoil(run) for run in runs], SMALL, kind)
    return rates


def cycle(random: np.random.Generator, names: list[str]) -> Iterator[str]:
    """Names in random order, all of them before one comes again."""
    while True:
        yield from random.permutation(names)


def study_plants(count: int, seed: int = 0) -> Rates:
    """Mistakes around two machines given by equations, whose parameters are off what is known of them."""
    rates, random = Rates(), np.random.default_rng(seed)
    for file, sizes in (("two_link_arm", np.array([3.0, 1.0])), ("trunk", np.full(6, 30.0))):
        plant = with_known_values(load_plant(EXAMPLES / f"{file}.py"))
        mistakes = plant_mistakes(plant)
        names = cycle(random, list(mistakes))
        for k in range(count):
            for case, values in (("alone", {}), ("beside an effect", draw_effect(plant, random, record(plant, random, sizes, 0.0)))):
                true = plant.with_values(draw_known(plant, random) | values)
                runs = [record(true, random, sizes, NOISE[plant.name]) for _ in range(4)]
                rates.judge(f"{plant.name}, no mistake", f"{plant.name} {k} {list(values)}", plant, runs, NOISE[plant.name], "")
                for name in (next(names) for _ in range(3)):
                    kind, spoil = mistakes[name]
                    label = f"{plant.name} {k} {name} {list(values)}"
                    rates.judge(f"{plant.name}, {case}", label, plant, [spoil(run) for run in runs], NOISE[plant.name], kind)
    return rates


def with_known_values(plant: SearchablePlant) -> SearchablePlant:
    """The plant with every known value within a fifth of it: wider ranges could turn an input's sign themselves."""
    narrow = {
        f.name: replace(f, low=max(f.low, f.start - 0.2 * abs(f.start) - 1e-3), high=min(f.high, f.start + 0.2 * abs(f.start) + 1e-3))
        for f in plant.free(plant.known)
    }
    return replace(plant, parameters={**plant.parameters, **narrow})  # type: ignore[type-var, attr-defined]


def draw_known(plant: SearchablePlant, random: np.random.Generator) -> dict[str, float]:
    """Values of the known parameters off their guesses by a tenth of their ranges."""
    free = plant.free(plant.known)
    width = [min(f.high - f.low, 4 * f.scale) for f in free]
    drawn = {f.name: float(f.start + random.normal() * 0.1 * w) for f, w in zip(free, width, strict=True)}
    return {f.name: float(np.clip(drawn[f.name], f.low, f.high)) for f in free}


def draw_effect(plant: SearchablePlant, random: np.random.Generator, run: Run) -> dict[str, float]:
    """Values of a random effect that changes the outputs of a run by 3 to 15 % of their motion, its largest probe or a part of it."""
    exact = plant.predict(run).points
    motion = float(np.std(exact - exact.mean(axis=0)))
    while True:
        candidate = plant.candidates[random.integers(len(plant.candidates))]
        probe = candidate.probes[-1]
        for part in 0.5 ** np.arange(12):
            strengths = {n: candidate.null[n] + part * (v - candidate.null[n]) for n, v in probe.items() if n not in candidate.shapes}
            values = {**probe, **strengths}
            try:
                change = float(np.std(plant.with_values(values).predict(run).points - exact))
            except PredictionError:
                continue
            if 0.03 * motion < change < 0.15 * motion:
                return values


def record(plant: SearchablePlant, random: np.random.Generator, sizes: np.ndarray, noise: float) -> Run:
    """A run of 10 s under sums of slow sines that begin at 0."""
    at = np.arange(0, 10, 0.02)
    waves = [(random.normal(size=len(sizes)), random.uniform(1, 6), random.uniform(0, 6)) for _ in range(4)]
    inputs = sum(a * (np.sin(w * at + p) - np.sin(p))[:, None] for a, w, p in waves) * 0.3 * sizes
    shape = (len(at), len(plant.signals.points), len(plant.signals.axes))
    run = Run("run.csv", "fit", at, inputs, np.zeros((len(at), 3)), np.zeros(shape))
    points = plant.predict(run).points
    return replace(run, points=points + noise * random.normal(size=points.shape))


if __name__ == "__main__":
    what, *more = sys.argv[1:]
    if what == "robot":
        study_robot(Path(more[0]), int(more[1]) if more[1:] else 1).show()
    else:
        count, seed = int(more[0]) if more else 4, int(more[1]) if more[1:] else 0
        {"network": study_network, "plants": study_plants}[what](count, seed).show()

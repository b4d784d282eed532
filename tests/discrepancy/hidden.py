"""Data sets in which an effect is hidden, made by the simulated rig: mechanics and functional forms that are not the model's.

`python -m tests.discrepancy.hidden FOLDER [--short] [--case KEY]` writes FOLDER/KEY for every case, and what is hidden to
FOLDER/labels/KEY.json.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.datasets import DataSet, write_dataset
from tepm_opt.data.run import Run
from tepm_opt.jobs.record import seed_of
from tepm_opt.models.channels import channels_of
from tepm_opt.models.robot import load_robot
from tepm_opt.studies.blind import machine
from tepm_opt.studies.blind.causes import make_setpoint_change
from tepm_opt.studies.blind.excitation import RATE, Excitation, excitations
from tepm_opt.studies.blind.machine import Commands, Deviation, Sight, rig_file

ROBOT = load_robot("kang2017")


@dataclass(frozen=True)
class Hidden:
    """A data set to be made.

    Attributes:
        key: name of the case.
        imperfections: of the rig, as a rig file has them.
        names: what is hidden, in SPEC's vocabulary; none where only parameters differ, "foreign" for what SPEC does not name.
        detail: by name, which actuator or point.
        sizes: parameters of the model's effects by full name, as far as they correspond to the rig's forms.
        seed: of the true parameters, the inputs and the noise.
        noise: of the tracker, 1 sigma per axis in m.
        before, after: what acts on the commands and on the points besides the rig's imperfections.
    """

    key: str
    imperfections: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    detail: Mapping[str, str] = field(default_factory=dict)
    sizes: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    noise: float = 3e-4
    before: Commands | None = None
    after: Sight | None = None


def true_factors(case: Hidden) -> dict[str, float]:
    """True parameters over the robot file's, drawn within its priors."""
    random = np.random.default_rng([case.seed, 1])
    return {name: 1 + float(random.uniform(-width, width)) for name, width in sorted(ROBOT.priors.items())}


def true_parameters(case: Hidden) -> dict[str, float]:
    """Those parameters of the robot that differ from its file, SI."""
    values = ROBOT.parameters.model_dump()
    return {name: values[name] * factor for name, factor in true_factors(case).items()}


def played(case: Hidden, run: Excitation) -> Run:
    """A run as it is recorded: inputs as commanded, points as measured."""
    hidden = Deviation(case.imperfections, true_factors(case), case.before, case.after)
    return machine.simulate_run(rig_file(ROBOT, hidden, case.noise, case.seed), hidden, run, seed_of(case.seed, run.file))


def make(case: Hidden, folder: Path, short: bool, jobs: int = 1) -> Path:
    """Write the data set of a case, which says nothing of what is hidden.

    Args:
        case: what to hide.
        folder: of the data set; one that is there is replaced.
        short: see `excitations`.
        jobs: processes that simulate runs; the data do not depend on it.
    """
    runs = excitations(case.seed, short)
    if jobs == 1:
        made = [played(case, run) for run in runs]
    else:
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
            made = list(pool.map(partial(played, case), runs))
    write_dataset(DataSet("experiment", ROBOT.name, channels_of(ROBOT), tuple(made), RATE, case.noise), folder, overwrite=True)
    return folder


def label(case: Hidden) -> dict[str, Any]:
    """What is hidden, for `labels/KEY.json`."""
    return {
        "names": case.names,
        "detail": case.detail,
        "sizes": case.sizes,
        "imperfections": case.imperfections,
        "true_parameters": true_parameters(case),
        "noise_m": case.noise,
        "seed": case.seed,
    }


def curved_lens(time: np.ndarray, points: np.ndarray) -> np.ndarray:
    """A foreign effect: the tracker's field bends with the square of the place, by 9 mm at 150 mm from its axis."""
    x, y, z = np.moveaxis(points, -1, 0)
    return points + 0.4 * np.stack([x * (z - 0.2), y * (z - 0.2) + 0.5 * x * y, -(x**2) - y**2], axis=-1)


@make_setpoint_change
def sagging_supply(time: np.ndarray, pressures: np.ndarray, tensions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A foreign effect: the common supply gives way under load, all pressures by 20 % where all muscles are at 0.3 MPa."""
    sag = 0.2 * (pressures.mean(axis=1, keepdims=True) / 0.3e6) ** 1.5
    return pressures * (1 - np.minimum(sag, 0.5)), tensions


@make_setpoint_change
def sticking_tendons(time: np.ndarray, pressures: np.ndarray, tensions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tendon friction without motion of the muscle: the tension at the end plays within 0.15 N and 15 % around the motor's."""
    ends = tensions.copy()
    for before, now in pairwise(ends):
        now[:] = np.clip(before, np.maximum(0.85 * now - 0.15, 0.0), 1.15 * now + np.minimum(now, 0.15))
    return pressures, ends


def _single(name: str, seed: int, sizes: Mapping[str, float], noise: float = 3e-4, detail: str = "", **rig: Any) -> Hidden:
    owner = f"{name}[{detail}]" if detail else name
    full = {f"{owner}.{key}": value for key, value in sizes.items()}
    return Hidden(name, {name: rig}, (name,), {name: detail} if detail else {}, full, seed, noise)


def _form(name: str, key: str, seed: int, detail: str = "", **imperfections: Mapping[str, Any]) -> Hidden:
    return Hidden(key, imperfections, (name,), {name: detail} if detail else {}, {}, seed)


def _pair(first: Hidden, second: Hidden, seed: int, noise: float) -> Hidden:
    return Hidden(
        f"{first.key}_and_{second.key}",
        {**first.imperfections, **second.imperfections},
        (*first.names, *second.names),
        {**first.detail, **second.detail},
        {**first.sizes, **second.sizes},
        seed,
        noise,
    )


SINGLES: tuple[Hidden, ...] = (
    _single("payload", 101, {"mass": 0.006}, 2e-4, mass_kg=0.006, eccentricity_m=(0.004, -0.003)),
    _single("mass_distribution", 102, {"plates": 0.077, "holders": 0.033}, 2e-4, fraction=0.11, holder_share=0.3),
    _single("rigid_plates", 103, {"stiffening": 0.200}, clamped_length_m=0.00556),
    _single("stiffness_hardening", 104, {"quadratic": 36.0, "cubic": 12.0}, growth=1.0),
    _single("structural_friction", 105, {"force": 0.13, "distance": 1.6e-4}, sliding_N=0.13),
    _single("creep", 106, {"share": 0.12}, 2e-4, fraction=0.12),
    _single("pressure_dead_zone", 107, {"threshold": 18e3}, threshold_Pa=18e3),
    _single("pressure_hysteresis", 108, {"width": 5e3}, width_Pa=10e3),
    _single("regulator_lag", 109, {"filling_time": 0.06, "exhausting_time": 0.13}, fill_s=0.06, exhaust_s=0.13),
    _single("time_delay", 110, {"delay": 0.06}, 2e-4, delay_s=0.06),
    _single("actuator_gain", 111, {"loss": 0.10}, detail="21", loss={"21": 0.10}),
    _single("pressure_crosstalk", 112, {"coupling": 0.08}, 2e-4, share=0.10),
    _single("tendon_friction", 113, {"constant": 0.03, "share": 0.2}, constant_N=0.03, share=0.2),
    _single("tendon_slack", 114, {"tension": 0.4}, 2e-4, length_m=0.07, winding_stiffness_N_per_m=8.0),
    _single("external_load", 115, {"x": 0.03, "y": -0.02, "z": -0.02}, force_N=(0.03, -0.02, -0.02)),
    _single("base_tilt", 116, {"x": -0.0262, "y": 0.0209}, rotation_deg=(-1.5, 1.2)),
    _single(
        "sensor_misalignment",
        117,
        {"rotation_x": 0.014, "rotation_y": -0.0105, "rotation_z": 0.021, "shift_x": 0.003, "shift_y": -0.002, "shift_z": 0.004},
        rotation_deg=(0.8, -0.6, 1.2),
        shift_m=(0.003, -0.002, 0.004),
    ),
    _single("actuator_offset", 119, {"pressure": 1e-3 * 358.86 / 50.27e-6}, detail="23", length_m={"23": 1e-3}),
    _single("regulator_leak", 124, {"share": 0.04}, detail="13", share={"13": 0.04}),
    _single("tension_gain", 125, {"loss": 0.25}, detail="21", loss={"21": 0.27}, bend=0.03),
    _single("actuator_scatter", 126, {}, area_spread=0.02, length_spread_m=3e-4, draw=1),
    _single(
        "tracker_drift",
        130,
        {},
        shift_m=(0.004, -0.003, 0.002),
        rotation_deg=(0.5, -0.3, 0.4),
        period_s=300.0,
    ),
    _single("warm_up", 131, {}, change=-0.06, full_s=25.0),
    _single("tendon_slip", 132, {"share": 0.4}, detail="12", share={"12": 0.4}, instant_s=17.0),
    _single("clock_skew", 133, {"rate": 0.004}, rate=0.004, bend_per_s=1e-5),
    _single("base_vibration", 134, {}, amplitude_m=(1e-3, -5e-4, 3e-4), frequency_Hz=7.3, phase_deg=50.0),
    _single("sensor_offset", 118, {"x": 0.005, "y": -0.004, "z": 0.003}, 2e-4, detail="s3", offset_m={"s3": (0.005, -0.004, 0.003)}),
)
OTHER_FORMS: tuple[Hidden, ...] = (
    _form("regulator_lag", "choked_filling", 120, choked_filling={"rate_per_s": 0.5, "band_Pa": 2e4}),
    _form("pressure_hysteresis", "uneven_hysteresis", 121, pressure_hysteresis={"width_Pa": 12e3, "asymmetry": -0.5}),
    _form("pressure_dead_zone", "soft_dead_zone", 122, pressure_dead_zone={"threshold_Pa": 18e3, "softness_Pa": 9e3}),
    _form("actuator_offset", "regulator_zero", 123, "12", actuator_offset={"zero_Pa": {"12": 4e3}}),
)
"""Causes in forms that differ more from the model's: valves that choke, loops that are not even, corners that are soft."""
_BY_KEY = {case.key: case for case in SINGLES}
CASES: tuple[Hidden, ...] = (
    *SINGLES,
    *OTHER_FORMS,
    _pair(_BY_KEY["payload"], _BY_KEY["regulator_lag"], 201, 3e-4),
    _pair(_BY_KEY["base_tilt"], _BY_KEY["pressure_dead_zone"], 202, 2e-4),
    Hidden(
        "sticking_tendons",
        names=("tendon_friction",),
        sizes={"tendon_friction.constant": 0.15, "tendon_friction.share": 0.15},
        seed=203,
        before=sticking_tendons,
    ),
    Hidden("null", seed=301),
    Hidden("curved_lens", names=("foreign",), detail={"foreign": "curved_lens"}, seed=401, after=curved_lens),
    Hidden("sagging_supply", names=("foreign",), detail={"foreign": "sagging_supply"}, seed=402, noise=2e-4, before=sagging_supply),
)


def main() -> None:
    """Write the cases and their labels."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--short", action="store_true", help="six runs of 6 … 8 s instead of seven of 20 … 25 s")
    parser.add_argument("--case", choices=[case.key for case in CASES], help="only this one")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    options = parser.parse_args()
    labels = options.folder / "labels"
    labels.mkdir(parents=True, exist_ok=True)
    for case in CASES:
        if options.case in (None, case.key):
            start = time.perf_counter()
            make(case, options.folder / case.key, options.short, options.jobs)
            (labels / f"{case.key}.json").write_text(json.dumps(label(case), indent=1) + "\n", encoding="utf-8")
            print(f"{case.key}: {time.perf_counter() - start:.1f} s", flush=True)


if __name__ == "__main__":
    main()

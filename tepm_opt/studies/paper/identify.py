"""Weighted least squares of the virtual prototype's sizes over the paper's numbers (`python -m tepm_opt.studies.paper.identify`).

Two groups of sizes, because two groups of numbers show them:

- Frictions and hysteresis act only in motion. They are those of the rig file given, chosen by hand from Fig. 10b's loop and Fig. 12's two
  modes (docs/results/paper.md).
- Parameter errors, plates, uneven mass and unequal muscles decide where the robot rests. They are fitted to the seven published errors of
  Figs. 7, 8 and 10a. A rest is computed by `Machine.settle`, which knows no dry friction, so what friction adds to the same experiment on
  the whole rig is put on top and renewed after every fit.

Sizes are held near their prior means by a weak penalty, parameter errors strictly within the priors of SPEC section 4.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from tepm_opt.data.metrics import point_errors
from tepm_opt.hw.simulation.machines import machine_of
from tepm_opt.hw.simulation.rigfile import RigFile, load_rig_file
from tepm_opt.models.compile import compile_model
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.studies.paper.common import Setting
from tepm_opt.studies.paper.load import FORCE
from tepm_opt.studies.paper.published import PUBLISHED
from tepm_opt.studies.paper.shapes import double_bend_inputs, elongation_inputs, settled_points

ACTUATORS = ("11", "12", "13", "21", "22", "23")
FACTORS = ("K_a", "alpha_2", "m_d")
TOLERANCE = 0.05  # relative, of a published number
CALM = 0.3  # weight of the penalty on a size that is one typical size away from its mean


@dataclass(frozen=True)
class Size:
    """Prior of a size that is sought: mean, typical size and limits."""

    mean: float
    typical: float
    low: float
    high: float


SIZES: Mapping[str, Size] = {
    "K_a": Size(1.0, 0.03, 0.97, 1.03),
    "alpha_2": Size(1.0, 0.05, 0.95, 1.05),
    "m_d": Size(1.0, 0.02, 0.98, 1.02),
    "clamped_length_m": Size(0.002, 0.004, 0.0, 0.008),
    "mass_fraction": Size(0.10, 0.15, 0.0, 0.32),
    "mass_side_x": Size(0.0, 0.05, -0.10, 0.10),
    "mass_side_y": Size(0.0, 0.05, -0.10, 0.10),
    **{f"loss_{name}": Size(0.0, 0.03, -0.06, 0.06) for name in ACTUATORS},
}


def rig_with(base: RigFile, values: np.ndarray) -> RigFile:
    """A rig file with the sizes (sizes,) in the order of `SIZES`; its frictions and devices stay."""
    of = {name: round(float(value), 5) for name, value in zip(SIZES, values, strict=True)}
    content = base.model_dump()
    content["parameter_factors"] |= {name: of[name] for name in FACTORS}
    parts, side = base.imperfections, (of["mass_side_x"], of["mass_side_y"])
    toward = {"fraction": float(np.hypot(*side)), "toward_deg": float(np.rad2deg(np.arctan2(side[1], side[0])))}
    changed = parts.replace_kinds(
        parts.rigid_plates.model_copy(update={"clamped_length_m": of["clamped_length_m"]}),
        parts.mass_distribution.model_copy(update={"fraction": of["mass_fraction"]}),
        parts.uneven_mass.model_copy(update=toward),
        parts.actuator_gain.model_copy(update={"loss": {name: of[f"loss_{name}"] for name in ACTUATORS}}),
    )
    content["imperfections"] = changed.model_dump()
    return RigFile.model_validate(content)


class Identification:
    """Figs. 7, 8 and 10a as functions of the sizes."""

    def __init__(self, base: RigFile) -> None:
        self.base, self.setting = base, Setting(compile_model(base.robot), base, 1)
        nothing = np.zeros(self.setting.model.layout.inputs)
        still = np.zeros(3)
        self.cases = {
            "fig7": (elongation_inputs(self.setting), still),
            "fig8": (double_bend_inputs(self.setting), still),
            "fig10": (nothing, FORCE),
        }
        self.nominal = {name: solve_statics(self.setting.model, *case).points for name, case in self.cases.items()}
        self.friction = {name: np.zeros_like(points) for name, points in self.nominal.items()}

    def rest(self, values: np.ndarray) -> dict[str, np.ndarray]:
        """Reference points at rest without friction, by figure."""
        found = {}
        for name, (inputs, force) in self.cases.items():
            machine = machine_of(rig_with(self.base, values))
            forces = np.zeros((self.setting.model.layout.points, 3))
            forces[-1] = force
            machine.settle(np.concatenate([inputs, np.ones(len(inputs) // 2)]), forces)
            found[name] = machine.network.points(machine.network.nodes)
        return found

    def renew(self, values: np.ndarray) -> None:
        """Run the experiments on the whole rig; what they differ by from the rest is friction's."""
        setting = Setting(self.setting.model, rig_with(self.base, values), 1)
        rest = self.rest(values)
        for name, (inputs, force) in self.cases.items():
            self.friction[name] = settled_points(setting, inputs, 1, force) - rest[name]

    def numbers(self, values: np.ndarray) -> dict[str, float]:
        """The published numbers as they come out, in mm, by key."""
        found = {}
        for name, points in self.rest(values).items():
            errors = 1e3 * point_errors(points + self.friction[name], self.nominal[name])
            ours = {"rmse": float(np.sqrt(np.mean(errors**2))), "s1": float(errors[0]), "s4": float(errors[-1])}
            found |= {f"{name}_{kind}": value for kind, value in ours.items() if f"{name}_{kind}" in PUBLISHED}
        return found

    def residuals(self, values: np.ndarray) -> np.ndarray:
        """Deviations over the tolerance, then the penalty."""
        deviations = [(value / PUBLISHED[key].value - 1) / TOLERANCE for key, value in self.numbers(values).items()]
        calm = [CALM * (value - size.mean) / size.typical for value, size in zip(values, SIZES.values(), strict=True)]
        return np.array(deviations + calm)

    def fit(self, rounds: int = 3, evaluations: int = 8) -> np.ndarray:
        """The sizes, (sizes,): fit, renew what friction adds, fit again."""
        sizes = list(SIZES.values())
        limits = (np.array([size.low for size in sizes]), np.array([size.high for size in sizes]))
        # away from the nominal robot, where errors vanish and have no slope
        values = np.array([size.mean + 0.2 * size.typical * (-1) ** k for k, size in enumerate(sizes)])
        for _ in range(rounds):
            self.renew(values)
            scale = np.array([size.typical for size in sizes])
            values = least_squares(self.residuals, values, bounds=limits, x_scale=scale, diff_step=3e-3, max_nfev=evaluations).x
        self.renew(values)
        return values


def main() -> None:
    """Print sizes and numbers; writing them into the rig file is left to a person."""
    parser = argparse.ArgumentParser(description="Identify the virtual prototype's sizes from the published numbers.")
    parser.add_argument("--rig", default="virtual_prototype", help="rig file whose frictions and devices are kept")
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    identification = Identification(load_rig_file(arguments.rig))
    values = identification.fit(arguments.rounds)
    for name, value in zip(SIZES, values, strict=True):
        print(f"{name} = {value:.5f}")
    for key, value in identification.numbers(values).items():
        print(f"{key}: published {PUBLISHED[key].value:g}, ours {value:.2f} {PUBLISHED[key].unit}")


if __name__ == "__main__":
    main()

"""Random machines around a robot file: what differs from one real robot to the next, and from both to the file.

Controllers are judged on many of them, so that none is tuned to one. Every value is drawn uniformly between limits (`VARIED`); a machine
is a function of its robot, seed and number. What a controller may know is the robot file alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tepm_opt.hw.simulation.imperfections import Imperfections, TimeDelay
from tepm_opt.hw.simulation.imperfections.body import MassDistribution, RigidPlates, UnevenMass
from tepm_opt.hw.simulation.imperfections.edges import StructuralFriction
from tepm_opt.hw.simulation.imperfections.pressure import ActuatorGain, PressureHysteresis, RegulatorLag
from tepm_opt.hw.simulation.imperfections.tendon import TendonFriction
from tepm_opt.hw.simulation.rigfile import DEFAULT, RigFile, load_rig_file
from tepm_opt.hw.simulation.scaling import MOST_CLAMPED, scale_rig
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot, load_robot


@dataclass(frozen=True)
class Varied:
    """One thing that differs from machine to machine.

    Attributes:
        low, high: limits of the uniform distribution.
        unit: of the value; "of the file's" multiplies what the robot file says.
        why: what makes it differ, and how far.
    """

    low: float
    high: float
    unit: str
    why: str


FILE = "of the file's"
VARIED = {
    "K_a": Varied(0.95, 1.05, FILE, "latex and sheath scatter from batch to batch; wider than the prior of 3 %"),
    "alpha_2": Varied(0.92, 1.08, FILE, "how much muscles share shear is the least known number of the model; prior 5 %"),
    "m_d": Varied(0.97, 1.03, FILE, "fittings and hoses; prior 2 %"),
    "c_a": Varied(0.70, 1.30, FILE, "damping was fitted to one decay; prior 25 %"),
    "loss": Varied(-0.10, 0.10, "of the pressure's force, each muscle", "muscles are made by hand; 5.8 % standard deviation"),
    "tendon_share": Varied(0.05, 0.45, "of the tension", "wrap angle times friction coefficient of the guides, dry to worn"),
    "tendon_constant": Varied(0.0, 0.06, "N", "gaskets"),
    "tendon_bristles": Varied(500.0, 4000.0, "N/m", "how far a tendon gives before it slides: a third to thrice the prototype's"),
    "body_share": Varied(0.0, 0.10, "of the elastic force", "muscles rub on plates and each other"),
    "hysteresis": Varied(5e3, 35e3, "Pa", "sheath on bladder; 1 to 7 % of the range"),
    "filling": Varied(0.6, 1.7, FILE, "length of hoses and supply"),
    "exhausting": Varied(0.6, 1.7, FILE, "likewise"),
    "latency": Varied(10e-3, 22e-3, "s", "trackers say 15 ms and jitter by filter setting"),
    "delay": Varied(3e-3, 12e-3, "s", "of the line and the board"),
    "plates": Varied(0.0, 0.008, "m", "caps clamp the muscle's ends"),
    "mass_fraction": Varied(0.0, 0.28, "of a module's mass", "in plates and holders instead of spread out"),
    "mass_side": Varied(0.0, 0.15, "of a node's mass", "sensor cables and fittings on one side"),
    "mass_toward": Varied(-180.0, 180.0, "deg", "which side"),
}


def random_machine(robot: str, seed: int, number: int) -> RigFile:
    """One machine of the family around a robot file.

    Grids, rate limits, monitors and the tracker's noise are the virtual prototype's; lags and delays those of the robot file, varied. What
    is drawn are values of the prototype's robot, which are scaled to others, see `scaling`.

    Args:
        robot: a built-in robot or the path of a robot file.
        seed: of the family.
        number: of the machine in it.

    Raises:
        InputError: as for `load_robot`.
    """
    known, base, random = load_robot(robot), load_rig_file(DEFAULT), np.random.default_rng([seed, number])
    names = Layout.from_robot(known).actuator_names
    drawn = {name: float(random.uniform(each.low, each.high)) for name, each in VARIED.items()}
    losses = random.uniform(VARIED["loss"].low, VARIED["loss"].high, len(names))
    machine = base.model_copy(
        update={
            "seed": int(random.integers(2**32)),
            "parameter_factors": {name: drawn[name] for name in ("K_a", "alpha_2", "m_d", "c_a")},
            "tracker": base.tracker.model_copy(update={"latency_s": drawn["latency"]}),
            "imperfections": _imperfections(base.nominal, drawn),
        }
    )
    found = scale_rig(machine, known)
    scattered = found.imperfections.replace_kinds(ActuatorGain(loss=dict(zip(names, map(float, losses), strict=True))))
    return found.model_copy(update={"name": f"machine {number} of seed {seed}", "robot": robot, "imperfections": scattered})


def _imperfections(robot: Robot, drawn: dict[str, float]) -> Imperfections:
    """The imperfections of a machine but for its muscles' losses, for values drawn by the names of `VARIED`."""
    known = robot.actuation
    height = robot.parameters.L_0 / robot.geometry.segments_per_module
    return Imperfections().replace_kinds(
        TimeDelay(delay_s=drawn["delay"]),
        RegulatorLag(fill_s=drawn["filling"] * known.filling_time_s, exhaust_s=drawn["exhausting"] * known.exhausting_time_s),
        StructuralFriction(share=drawn["body_share"]),
        TendonFriction(
            constant_N=drawn["tendon_constant"], share=drawn["tendon_share"], bristle_stiffness_N_per_m=drawn["tendon_bristles"]
        ),
        PressureHysteresis(width_Pa=drawn["hysteresis"]),
        RigidPlates(clamped_length_m=min(drawn["plates"], MOST_CLAMPED * height)),
        MassDistribution(fraction=drawn["mass_fraction"], holder_share=0.3),
        UnevenMass(fraction=drawn["mass_side"], toward_deg=drawn["mass_toward"]),
    )

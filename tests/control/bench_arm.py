"""The paper's bench (Fig. 5) as an arm for the predictive controller: one muscle written as three equal ones side by side on a guide."""

from __future__ import annotations

from dataclasses import replace
from types import TracebackType

import numpy as np

from tepm_opt.control.estimation.kalman_filter import FilterSettings
from tepm_opt.control.mpc.controller import MpcSettings
from tepm_opt.control.references.reference import PERIOD, Reference, minimum_jerk
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.hw.rig import Command, Sample, Simulated
from tepm_opt.hw.simulation.bench import BenchRig
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.robot import Robot
from tepm_opt.solvers.mechanics.statics import Equilibrium, solve_actuated_statics

MUSCLES = 3


def guided(robot: Robot) -> Robot:
    """A robot of one actuator (`BenchRig.robot`) as one whose plates slide on rails, driven by three muscles with a third of all each.

    The tracker measures a length between two sensors, whose noise adds up.
    """
    value, actuation = robot.parameters, robot.actuation
    third = {"A": value.A / MUSCLES, "K_a": value.K_a / MUSCLES, "c_a": value.c_a / MUSCLES, "alpha_2": 1e-6, "beta_1": 0.0, "beta_2": 0.0}
    tensions = {
        "tension_max_N": actuation.tension_max_N / MUSCLES,
        "tension_full_scale_N": actuation.tension_full_scale_N / MUSCLES,
        "tension_rate_N_per_s": actuation.tension_rate_N_per_s / MUSCLES,
    }
    geometry = {"modules": 1, "actuator_angles_deg": [90.0, 210.0, 330.0], "guide": True}
    mount = {"gravity_m_per_s2": [0.0, 0.0, 0.0], "base_position_m": [0.0, 0.0, 0.0], "base_rotation_deg": [0.0, 0.0, 0.0]}
    tracker = robot.tracker and robot.tracker.model_copy(update={"noise_rms_m": np.sqrt(2) * robot.tracker.noise_rms_m})
    parts = {
        "name": f"{robot.name} on a guide",
        "parameters": value.model_copy(update=third),
        "actuation": actuation.model_copy(update=tensions),
        "geometry": robot.geometry.model_copy(update=geometry),
        "mount": robot.mount.model_copy(update=mount),
        "tracker": tracker,
    }
    return robot.model_copy(update=parts)


def reference_by_forces(model: CompiledModel, forces: np.ndarray, period: float = PERIOD) -> Reference:
    """Equilibria of axial forces, (periods, actuators) in N, a control period in s apart; targets are their tips."""
    found: list[Equilibrium] = []
    for row in forces:
        effective = np.concatenate([row / model.values["A"], np.zeros(len(row))])
        found.append(solve_actuated_statics(model, effective, model.check_loads(None), found[-1] if found else None, explain=True))
        assert found[-1].solved, found[-1].outcome
    count = len(forces)
    tips = np.array([at.tip for at in found])
    return Reference(tips, np.array(forces), found, np.ones(count, dtype=bool), np.zeros(count, dtype=int), period)


def length_reference(model: CompiledModel, lengths: np.ndarray, stay: float, move: float = 0.5, period: float = PERIOD) -> Reference:
    """Stays at one length after the other, each reached smoothly; starts at the free length.

    Args:
        model: the compiled guided robot.
        lengths: where to stay, (targets,) in m.
        stay: time for each length in s, the way there included.
        move: time of the way there in s.
        period: control period in s.
    """
    part = minimum_jerk(period * np.arange(round(stay / period)) / move)
    before = np.append(model.values["L_0"], lengths[:-1])
    course = np.concatenate([start + part * (end - start) for start, end in zip(before, lengths, strict=True)])
    forces = model.values["K_a"] * (course - model.values["L_0"])
    found = reference_by_forces(model, np.repeat(forces[:, None], MUSCLES, axis=1), period)
    return replace(found, point=np.repeat(np.arange(len(lengths)), len(part)))


def bench_settings() -> MpcSettings:
    """Settings for muscles with a third of the force each: what is meant in N is a third of the arm's.

    The noise of a length is large beside what a force does to it, so unknown forces are followed more slowly.
    """
    settings = MpcSettings()
    weights, filter = settings.weights, FilterSettings()
    smaller = replace(
        filter,
        force_drift=filter.force_drift / MUSCLES / 3,
        force_correlation_time=1.0,
        force_noise=filter.force_noise / MUSCLES,
        friction_std=filter.friction_std / MUSCLES,
        friction_drift=filter.friction_drift / MUSCLES,
        reversal_noise=filter.reversal_noise / MUSCLES,
    )
    lighter = replace(weights, force=weights.force / MUSCLES, change=weights.change / MUSCLES)
    return replace(settings, weights=lighter, filter=smaller)


class BenchArm:
    """A bench that looks like the guided robot: one point at the actuator's end, three muscles of which each does a third.

    Attributes:
        bench: as given.
        robot: `guided`, of three muscles.
    """

    def __init__(self, bench: BenchRig) -> None:
        self.bench = bench
        self.robot = guided(bench.robot)

    def __repr__(self) -> str:
        return f"BenchArm({self.bench!r})"

    @property
    def time(self) -> float:
        """Seconds since the bench's start."""
        return self.bench.time

    @property
    def simulated(self) -> Simulated:
        """The arm itself."""
        return self

    def reseed(self, noise: int, began: float = 0.0) -> None:
        """Draw other noise for the same bench; 0 is its own."""
        self.bench.reseed(noise, began)

    def read(self) -> Sample:
        """The bench's next sample."""
        sample = self.bench.read()
        length = np.nan if sample.lengths is None else float(sample.lengths[0])
        points = np.full((2, 3), np.nan)
        points[1] = (0.0, 0.0, length) if np.isfinite(length) else np.nan
        return Sample(sample.time, points, lengths=sample.lengths, status=sample.status)

    def read_many(self, count: int) -> list[Sample]:
        """The next sample; see `BenchRig.read_many`."""
        return [self.read()]

    def apply(self, command: Command) -> None:
        """Command the mean of the three pressures and the sum of the three tensions."""
        pressure, tension = np.array([command.pressures.mean()]), np.array([command.tensions.sum()])
        self.bench.apply(Command(pressure, tension, command.enabled[:1]))

    def schedule(self, setpoints: SetPoints, linear: bool = True) -> None:
        """The mean of the pressures, the tensions together; see `BenchRig.schedule`."""
        pressures, tensions = np.split(setpoints.inputs, 2, axis=1)
        inputs = np.stack([pressures.mean(axis=1), tensions.sum(axis=1)], axis=1)
        self.bench.schedule(SetPoints(setpoints.time, inputs, setpoints.tip_force), linear)

    def push(self, forces: np.ndarray) -> None:
        """Refuse as the bench does, which cannot push."""
        self.bench.push(forces)

    @property
    def true_points(self) -> np.ndarray:
        """Middle and end, (2, 3) in m."""
        return self.bench.true_points[1] * np.array([[0.5], [1.0]])

    @property
    def true_nodes(self) -> np.ndarray:
        """Nodes of all muscles, which are at the same place, (n + 1, 3, 3) in m."""
        return np.repeat(self.bench.true_nodes, MUSCLES, axis=1)

    @property
    def true_lengths(self) -> np.ndarray:
        """Lengths of the muscles, (3,) in m."""
        return np.repeat(self.bench.true_lengths, MUSCLES)

    def stop(self) -> None:
        """Stop the bench."""
        self.bench.stop()

    def __enter__(self) -> BenchArm:
        """The arm itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Stop."""
        self.stop()

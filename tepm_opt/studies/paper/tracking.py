"""Fig. 12: the circle of Eq. (7), point by point, by the lengths of the actuators."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context

import numpy as np

from tepm_opt.control.baselines.length_control import HoldRecord, HoldTask, LengthController, LengthTarget, TendonUse, hold
from tepm_opt.control.estimation.lengths import LengthEstimator
from tepm_opt.hw.simulation.rigfile import RigFile
from tepm_opt.models.compile import compile_model
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.kinematics.ik import solve_trajectory
from tepm_opt.solvers.planning.trajectories import circle
from tepm_opt.studies.paper.common import Setting
from tepm_opt.studies.paper.result import ExperimentResult

APPROACH, STAY, TAKEN = 3.0, 3.0, 1.0  # s: to the first point; at each point; at its end, for the error (SPEC section 6)


def targets(setting: Setting, points: int = 32) -> tuple[np.ndarray, list[LengthTarget]]:
    """Tip positions (points, 3) in m and the lengths of the equal-curvature configurations there."""
    positions = circle().positions[:points]
    found = solve_trajectory(setting.model, positions, ActuationMode.PRESSURE)
    return positions, [LengthTarget(c.equilibrium.lengths.ravel(), c.forces) for c in found]


def follow(setting: Setting, use: TendonUse, noise: int, wanted: list[LengthTarget]) -> HoldRecord:
    """One round on the prototype; lengths are estimated from the tracked points.

    Args:
        setting: what all experiments start from.
        use: mode of the length controller.
        noise: number of the run, which decides the noise of its devices.
        wanted: lengths to hold, one after the other, (modules · actuators,) in m each.
    """
    estimator = LengthEstimator(setting.model)
    rig = setting.prototype(noise)
    controller = LengthController(rig.robot, use)
    with rig:
        return hold(rig, controller, lambda sample: estimator.update(sample.points), HoldTask(wanted, STAY, APPROACH), setting.clock.part())


def _follow_alone(file: RigFile, use: TendonUse, noise: int, wanted: list[LengthTarget]) -> HoldRecord:
    """`follow` in a process of its own, which compiles (or finds) the model for itself."""
    return follow(Setting(compile_model(file.robot), file), use, noise, wanted)


def rounds(setting: Setting, wanted: list[LengthTarget]) -> dict[TendonUse, list[HoldRecord]]:
    """All rounds of both modes, beside each other where there are processors for it; the result does not depend on that."""
    jobs = [(use, noise) for use in TendonUse for noise in range(1, setting.runs + 1)]
    if setting.workers < 2:
        done = [follow(setting, use, noise, wanted) for use, noise in jobs]
    else:
        with ProcessPoolExecutor(min(setting.workers, len(jobs)), get_context("spawn")) as pool:
            waiting = [pool.submit(_follow_alone, setting.rig, use, noise, wanted) for use, noise in jobs]
            try:
                for _ in as_completed(waiting):
                    setting.clock.advance(APPROACH + STAY * len(wanted))
            except KeyboardInterrupt:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
            done = [job.result() for job in waiting]
    return {use: [held for (of, _), held in zip(jobs, done, strict=True) if of is use] for use in TendonUse}


def average_held_tips(held: HoldRecord, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Mark samples of the last second at a point, (samples,) of bool, and average the tip at each point, (count, 3) in m."""
    at_end = (held.target >= 0) & ((held.time - APPROACH) % STAY > STAY - TAKEN)
    tips = np.array([np.nanmean(held.points[at_end & (held.target == k), -1], axis=0) for k in range(count)])
    return at_end, tips


def track_circle(setting: Setting, points: int = 32) -> ExperimentResult:
    """Experiment of Fig. 12: the circle of Eq. (7) in both modes."""
    positions, wanted = targets(setting, points)
    numbers, tables, share = {}, {}, {}
    data = {"target": positions}
    for use, of_mode in rounds(setting, wanted).items():
        squares, tips, enabled = [], [], []
        for held in of_mode:
            at_end, mean = average_held_tips(held, points)
            missed = held.points[at_end, -1] - positions[held.target[at_end]]
            squares.append(np.nanmean((missed**2).sum(axis=1)))
            tips.append(mean)
            enabled.append(held.enabled[at_end].mean())
        numbers[f"fig12_mode{use.value}"] = float(1e3 * np.mean(np.sqrt(squares)))
        tip = np.mean(tips, axis=0)
        data[f"mode{use.value}"] = tip
        columns = {f"target_{axis}_m": positions[:, k] for k, axis in enumerate("xyz")}
        columns |= {f"tip_{axis}_m": tip[:, k] for k, axis in enumerate("xyz")}
        tables[f"fig12_mode{use.value}"] = {"angle_rad": 2 * np.pi * np.arange(points) / 32, **columns}
        share[use] = float(np.mean(enabled))
    method = (
        f"Length PID of every actuator; set points are the lengths of the equal-curvature inverse kinematics, feed-forward its axial "
        f"forces, lengths those of the nominal equilibrium that fits s1 … s4 best. {STAY:g} s a point; the error is that of every tracker "
        f"frame of the last {TAKEN:g} s, its root mean square over {points} points, averaged over {setting.repeated}. In mode 2 the "
        f"motors were enabled {100 * share[TendonUse.ADJUSTS]:.0f} % of that time."
    )
    checks = {"mode 2 tracks better than mode 1": numbers["fig12_mode2"] < numbers["fig12_mode1"]}
    return ExperimentResult("fig12", "Position tracking", method, numbers, checks, tables, data)

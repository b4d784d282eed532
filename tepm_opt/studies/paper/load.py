"""Fig. 10: a force at the tip; bending and return."""

from __future__ import annotations

import numpy as np

from tepm_opt.data.metrics import point_errors, shape_error
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.studies.paper.common import Setting, middle
from tepm_opt.studies.paper.result import ExperimentResult
from tepm_opt.studies.paper.shapes import settled_points, shape_table

FORCE = np.array([2.5, 0.0, 0.0])  # N in G, normal to the straight backbone
RAMP, KNOTS = 10.0, 21  # s, one way; set points on it


def tilt(rig: SimulatedRig) -> float:
    """Angle between tip plate and base plate in rad, as a sensor with six degrees of freedom on the plate would tell."""
    nodes = rig.true_nodes
    normals = [np.cross(level[1] - level[0], level[2] - level[0]) for level in (nodes[0], nodes[-1])]
    return float(np.arccos(np.clip(normals[0] @ normals[1] / (np.linalg.norm(normals[0]) * np.linalg.norm(normals[1])), -1, 1)))


def bend_and_return(setting: Setting, noise: int, ramp: float = RAMP) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time in s, tip force in N and bending angle in rad while the force rises and falls slowly, (samples,) each.

    The force grows with the square of time and falls likewise: near zero, where the robot is softest, it changes most slowly.
    """
    rig = setting.prototype(noise)
    knots = np.linspace(0.0, 2 * ramp, 2 * KNOTS - 1)
    size = (1 - np.abs(knots / ramp - 1)) ** 2
    rig.schedule(SetPoints(knots, np.zeros((len(knots), setting.model.layout.inputs)), size[:, None] * FORCE))
    rows, progress = [], setting.clock.part()
    while not rows or rows[-1][0] < 2 * ramp - 1e-9:
        time = rig.read().time
        rows.append((time, float(np.interp(time, knots, size * FORCE[0])), tilt(rig)))
        progress("force", time, 2 * ramp)
    time, force, angle = np.array(rows).T
    return time, force, angle


def hysteresis(force: np.ndarray, angle: np.ndarray) -> tuple[float, float]:
    """Width of the loop and what is left at its end, both in parts of the largest angle.

    The width is the largest difference of the angle between return and bending at the same force. Angles are taken about that of the
    start, where the robot may already lean a little.
    """
    top = int(np.argmax(force))
    bent = angle - angle[0]
    grid = np.linspace(0.02, 0.98, 97) * force[top]
    up = np.interp(grid, force[: top + 1], bent[: top + 1])
    down = np.interp(grid, force[top:][::-1], bent[top:][::-1])
    return float(np.abs(down - up).max() / bent.max()), float(abs(bent[-1]) / bent.max())


def run_load_experiment(setting: Setting) -> ExperimentResult:
    """Run the experiment of Fig. 10, both parts: bending under a force at the tip, and bending and return."""
    nothing = np.zeros(setting.model.layout.inputs)
    at = solve_statics(setting.model, nothing, FORCE)
    runs = [settled_points(setting, nothing, noise, FORCE) for noise in range(1, setting.runs + 1)]
    errors = [float(shape_error(points, at.points)) for points in runs]
    shown = runs[middle(errors)]
    time, force, angle = bend_and_return(setting, 1)
    width, residual = hysteresis(force, angle)
    numbers = {
        "fig10_rmse": 1e3 * errors[middle(errors)],
        "fig10_angle": float(np.rad2deg(angle.max())),
        "fig10_hysteresis": 100 * width,
    }
    checks = {"no residual: below 2 % of the largest angle when the force is gone": residual < 0.02}
    method = (
        f"{FORCE[0]:g} N along x at the tip of the robot without inputs. (a) As Figs. 7 and 8. (b) The force rises and falls within "
        f"{RAMP:g} s each, with the square of time; the angle is the tip plate's tilt. Hysteresis is the largest difference of the "
        f"angle at equal force over the largest angle. Residual here: {100 * residual:.1f} %. "
        f"The nominal model bends by {np.rad2deg(at.tip_tilt):.1f}°."
    )
    tables = {
        "fig10a": shape_table(setting, at.points, shown),
        "fig10b": {"time_s": time, "tip_force_N": force, "bending_angle_rad": angle},
    }
    data = {"model": at.points, "prototype": shown, "errors": 1e3 * point_errors(shown, at.points), "force": force, "angle": angle}
    return ExperimentResult("fig10", "Elastic deformation and return", method, numbers, checks, tables, data)

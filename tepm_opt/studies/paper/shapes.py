"""Figs. 7 to 9: the same inputs on model and prototype, elongation, double bend, dynamic bend."""

from __future__ import annotations

import numpy as np

from tepm_opt.data.metrics import point_errors, shape_error
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.studies.paper.common import SWAY, Setting, inputs_of, middle, play, ramp
from tepm_opt.studies.paper.result import ExperimentResult

RISE, HOLD = 2.0, 3.0  # s
BEND = 3.0  # s, of Fig. 9's ramp


def elongation_inputs(setting: Setting) -> np.ndarray:
    """Fig. 7: 0.2 MPa in module 1, 0.3 MPa in module 2."""
    return inputs_of(setting.model.robot, {"11": 0.2e6, "12": 0.2e6, "13": 0.2e6, "21": 0.3e6, "22": 0.3e6, "23": 0.3e6})


def double_bend_inputs(setting: Setting) -> np.ndarray:
    """Fig. 8: 0.25 MPa in A21 and A13, 7 N on A22 and A23."""
    return inputs_of(setting.model.robot, {"21": 0.25e6, "13": 0.25e6}, {"22": 7.0, "23": 7.0})


def dynamic_bend_inputs(setting: Setting) -> np.ndarray:
    """Fig. 9: 0.15 MPa in A11 and A21, 3 N on the other four."""
    return inputs_of(setting.model.robot, {"11": 0.15e6, "21": 0.15e6}, {"12": 3.0, "13": 3.0, "22": 3.0, "23": 3.0})


def settled_points(setting: Setting, inputs: np.ndarray, noise: int, force: np.ndarray | None = None) -> np.ndarray:
    """Find the prototype's points after a ramp, (points, 3) in m: the mean over the last period of its sway.

    Args:
        setting: what all experiments start from.
        inputs: u at the ramp's end, (2 · modules · actuators,) in Pa and N.
        noise: number of the run, which decides the noise of its devices.
        force: tip force at the ramp's end in G, (3,) in N; zero where absent.
    """
    time, points = play(setting.prototype(noise), ramp(inputs, RISE, force=force), RISE + HOLD, setting.clock.part())
    return np.nanmean(points[time > RISE + HOLD - SWAY], axis=0)


def elongation(setting: Setting) -> ExperimentResult:
    """Experiment of Fig. 7: elongation."""
    return _static(setting, "fig7", "Elongation", elongation_inputs(setting))


def double_bend(setting: Setting) -> ExperimentResult:
    """Experiment of Fig. 8: double bend."""
    return _static(setting, "fig8", "Double bend", double_bend_inputs(setting))


def _static(setting: Setting, figure: str, title: str, inputs: np.ndarray) -> ExperimentResult:
    model = solve_statics(setting.model, inputs).points
    runs = [settled_points(setting, inputs, noise) for noise in range(1, setting.runs + 1)]
    errors = [float(shape_error(points, model)) for points in runs]
    shown = middle(errors)
    each = 1e3 * point_errors(runs[shown], model)
    numbers = {f"{figure}_rmse": 1e3 * errors[shown], f"{figure}_s1": float(each[0]), f"{figure}_s4": float(each[-1])}
    method = (
        f"From rest the inputs rise within {RISE:g} s and stay for {HOLD:g} s; points are means over the last {SWAY:g} s. "
        f"The model is the nominal network's equilibrium. Shown is the middle of {setting.repeated} by Eq. (5)."
    )
    tables = {figure: shape_table(setting, model, runs[shown])}
    checks = {"the error grows from the base to the tip": bool((np.diff(each) > 0).all())}
    return ExperimentResult(figure, title, method, numbers, checks, tables, {"model": model, "prototype": runs[shown], "errors": each})


def shape_table(setting: Setting, model: np.ndarray, prototype: np.ndarray) -> dict[str, np.ndarray]:
    """Reference points of model and prototype and their distance as columns."""
    columns: dict[str, np.ndarray] = {"point": np.array(setting.model.layout.point_names, dtype=np.str_)}
    for name, points in (("model", model), ("prototype", prototype)):
        columns |= {f"{name}_{axis}_m": points[:, k] for k, axis in enumerate("xyz")}
    return {**columns, "error_m": point_errors(prototype, model)}


def dynamic_bend(setting: Setting) -> ExperimentResult:
    """Experiment of Fig. 9: dynamic bend."""
    setpoints = ramp(dynamic_bend_inputs(setting), BEND)
    time, model = play(setting.twin(), setpoints, BEND, setting.clock.part())
    runs = [play(setting.prototype(noise), setpoints, BEND, setting.clock.part())[1] for noise in range(1, setting.runs + 1)]
    total = [float(np.sqrt(np.mean(point_errors(points, model) ** 2))) for points in runs]
    shown = runs[middle(total)]
    errors = 1e3 * point_errors(shown, model)
    instant, point = np.unravel_index(np.argmax(errors), errors.shape)
    numbers = {"fig9_largest": float(errors.max()), "fig9_time": float(time[instant]), "fig9_point": float(point + 1)}
    method = (
        f"The inputs are ramps from 0 to {BEND:g} s on model and prototype; errors are taken at the tracker's frames. The model moves "
        f"without delays and lags. Shown is the middle of {setting.repeated} by Eq. (5) over time."
    )
    names = setting.model.layout.point_names
    columns = {"time_s": time, **{f"error_{name}_m": 1e-3 * errors[:, k] for k, name in enumerate(names)}}
    for label, points in (("model", model), ("prototype", shown)):
        columns |= {f"{label}_{name}_{axis}_m": points[:, k, i] for k, name in enumerate(names) for i, axis in enumerate("xyz")}
    data = {"time": time, "errors": errors, "model": model, "prototype": shown}
    return ExperimentResult("fig9", "Dynamic bend", method, numbers, {}, {"fig9": columns}, data)

"""Fig. 11: the tip's height against one pressure or one tension."""

from __future__ import annotations

import numpy as np

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.solvers.linear.gain import input_curve
from tepm_opt.studies.paper.common import Setting, inputs_of, play
from tepm_opt.studies.paper.result import ExperimentResult

LAST, DURATION = 0.60, 12.0  # part of the range, s
INTERVALS = {"10–20 %": (0.10, 0.20), "45–55 %": (0.45, 0.55)}


def sweep(setting: Setting, actuation: str, noise: int) -> tuple[np.ndarray, np.ndarray]:
    """Part of the range (samples,) and z_s4 in m (samples,) while one input of A13 rises slowly from rest, all others zero."""
    robot = setting.model.robot
    high = {"pressure": robot.actuation.pressure_max_Pa, "tension": robot.actuation.tension_max_N}[actuation]
    one = {"13": LAST * high}
    last = inputs_of(robot, one) if actuation == "pressure" else inputs_of(robot, tensions=one)
    setpoints = SetPoints(np.array([0.0, DURATION]), np.array([0 * last, last]), np.zeros((2, 3)))
    time, points = play(setting.prototype(noise), setpoints, DURATION, setting.clock.part())
    return LAST * time / DURATION, points[:, -1, 2]


def open_loop_gain(setting: Setting) -> ExperimentResult:
    """Experiment of Fig. 11: the tip's height against one pressure or one tension."""
    curves: dict[str, tuple[np.ndarray, np.ndarray]] = {kind: sweep(setting, kind, 1) for kind in ("pressure", "tension")}
    spread: dict[tuple[str, str], float] = {}
    slope: dict[tuple[str, str], float] = {}
    around: dict[tuple[str, str], float] = {}
    for kind, (part, height) in curves.items():
        for interval, (low, high) in INTERVALS.items():
            inside = (part >= low) & (part <= high)
            line = np.polyfit(part[inside], height[inside], 1)
            slope[kind, interval] = float(line[0])
            spread[kind, interval] = float(height[inside].std())
            around[kind, interval] = float((height[inside] - np.polyval(line, part[inside])).std())
    first = next(iter(INTERVALS))
    numbers = {f"fig11_{kind}_sd": 1e3 * spread[kind, first] for kind in curves}
    checks = {
        f"{interval}: z_s4 falls with both, |g33| > |g39|": slope["pressure", interval] < slope["tension", interval] < 0
        for interval in INTERVALS
    }
    checks["tension spreads z_s4 less than pressure"] = all(spread["tension", i] < spread["pressure", i] for i in INTERVALS)
    gains = "; ".join(f"{i}: {1e3 * slope['pressure', i]:.0f} and {1e3 * slope['tension', i]:.0f} mm per range" for i in INTERVALS)
    others = "; ".join(f"{i}: {1e3 * spread['pressure', i]:.2f} and {1e3 * spread['tension', i]:.2f} mm" for i in INTERVALS)
    smooth = "; ".join(f"{i}: {1e3 * around['pressure', i]:.2f} and {1e3 * around['tension', i]:.2f} mm" for i in INTERVALS)
    method = (
        f"p13, then λ13, rises from 0 to {100 * LAST:g} % of its range within {DURATION:g} s, all other inputs zero. The paper does not "
        f"say about what its standard deviations are taken; here they are those of z_s4 over the interval of Fig. 11(a). "
        f"Pressure and tension, slopes: {gains}; SD over the interval: {others}; about the straight line: {smooth}."
    )
    tables = {f"fig11_{kind}": {"part": part, "tip_z_m": height} for kind, (part, height) in curves.items()}
    model = {(k, i): input_curve(setting.model, k, "13", *INTERVALS[i]) for k in ("pressure", "tension") for i in INTERVALS}  # type: ignore[arg-type]
    return ExperimentResult("fig11", "Open-loop gain", method, numbers, checks, tables, {"curves": curves, "model": model})

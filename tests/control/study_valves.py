"""Regulators that are not as the robot file says: `python -m tests.control.study_valves NOISES RATIO …` prints a line for each.

A ratio is that of the prototype's true lags to the file's. The true tip's error on the circle is in mm rms, mean and worst of the noises,
over the circle and from its third second on.
"""

from __future__ import annotations

import sys

import numpy as np

from tepm_opt.control.loop import close_loop
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.hw.simulation.rigfile import RigFile, load_rig_file
from tests.control.study import APPROACH, PAUSE, model, prototype, reference


def with_lags(ratio: float) -> RigFile:
    """The virtual prototype with lags that are a ratio of its own."""
    file = load_rig_file()
    lag = file.imperfections.regulator_lag
    changed = lag.model_copy(update={"fill_s": ratio * lag.fill_s, "exhaust_s": ratio * lag.exhaust_s})
    return file.model_copy(update={"imperfections": file.imperfections.model_copy(update={"regulator_lag": changed})})


def valves(noises: int, ratio: float) -> None:
    """Print the line of a ratio."""
    found = []
    for seed in range(1, noises + 1):
        done = close_loop(prototype(seed, with_lags(ratio)), Mpc(model(), reference("circle")), model().robot)
        error, late = 1e3 * np.linalg.norm(np.array(done.truth) - done.targets, axis=1), np.array(done.time) > APPROACH + PAUSE + 3.0
        found.append([float(np.sqrt(np.mean(error[done.counted & part] ** 2))) for part in (True, late)])
    mean, worst = np.mean(found, axis=0), np.max(found, axis=0)
    print(f"{ratio:5g}  circle {mean[0]:.2f} ({worst[0]:.2f})  from the third second {mean[1]:.2f} ({worst[1]:.2f})", flush=True)


if __name__ == "__main__":
    for each in sys.argv[2:]:
        valves(int(sys.argv[1]), float(each))

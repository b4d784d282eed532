"""Data sets of a linear drive (`real/emps_friction`): the same force written into different columns."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from tepm_opt.data.tables import write_columns

AREA = 1e-4  # m², of examples/emps_guide.py
RUNS = {"estimation": "DATA_EMPS.mat", "pulses": "DATA_EMPS_PULSES.mat"}
DESCRIPTION = """name = "EMPS"
start = "measured"
piece_s = 2.0
runs = [
  { file = "estimation.csv", role = "fit", start = "free" },
  { file = "pulses.csv", role = "validation" },
]
[noise]
position = 1e-4
"""
Columns = dict[str, np.ndarray]


def emps(shared: Path, out: Path) -> None:
    """The motor's force as an input of its own, in N."""
    _write(shared, out, lambda force: {"force": force})


def emps_tip_force(shared: Path, out: Path) -> None:
    """The force as one on the tip, in kN."""
    _write(shared, out, lambda force: {"tip_force_x_kN": 1e-3 * force})


def emps_guide(shared: Path, out: Path) -> None:
    """The force as a pressure in Pa where it pushes and a tension in N where it pulls."""
    _write(shared, out, lambda force: {"pressure": np.maximum(force, 0.0) / AREA, "tension": np.maximum(-force, 0.0)})


def measured(shared: Path, run: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time in s, motor force in N and position in m of a run."""
    found = loadmat(shared / "real" / "emps_friction" / RUNS[run])
    return found["t"].ravel(), float(found["gtau"].ravel()[0]) * found["vir"].ravel(), found["qm"].ravel()


def _write(shared: Path, out: Path, columns: Callable[[np.ndarray], Columns]) -> None:
    out.mkdir(parents=True, exist_ok=True)
    for run in RUNS:
        time, force, position = measured(shared, run)
        write_columns(out / f"{run}.csv", {"time_s": time, **columns(force), "position": position})
    (out / "dataset.toml").write_text(DESCRIPTION, encoding="utf-8")

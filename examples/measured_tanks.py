"""Data sets of two tanks, one below the other (`benchmarks/cascaded_tanks`; Schoukens and Noël 2017)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tepm_opt.data.tables import write_columns

APART = 4.0  # s
DESCRIPTION = """name = "cascaded tanks"
start = "free"
runs = [
  { file = "estimation.csv", role = "fit" },
  { file = "validation.csv", role = "validation" },
]
[noise]
level = 0.05
"""


def tanks(shared: Path, out: Path) -> None:
    """The recording to fit and the one to validate; nobody knows the levels with which they begin."""
    path = shared / "benchmarks" / "cascaded_tanks" / "dataBenchmark.csv"
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    out.mkdir(parents=True, exist_ok=True)
    for name, pump, level in (("estimation", 0, 2), ("validation", 1, 3)):
        columns = {"time_s": APART * np.arange(len(table)), "pump": table[:, pump], "level": table[:, level]}
        write_columns(out / f"{name}.csv", columns)
    (out / "dataset.toml").write_text(DESCRIPTION, encoding="utf-8")

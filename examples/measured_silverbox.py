"""Data set of an electronic circuit (`benchmarks/silverbox`): four of ten multisines to fit to; the arrow leaves their range and judges."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tepm_opt.data.tables import write_columns

STEP = 2**14 / 1e7  # s
QUIET = 420  # samples before anything happens: they tell the means
STARTS = {"multisine_1": 40540, "multisine_4": 66616, "multisine_7": 92693, "multisine_9": 110077}  # each begins at rest in a gap
LENGTH, ARROW = 8690, 40400  # samples
DESCRIPTION = """name = "Silverbox"
runs = [
{runs}  {{ file = "arrow.csv", role = "validation" }},
]
[noise]
position = 3e-4
"""


def silverbox(shared: Path, out: Path) -> None:
    """Input and output in V, means removed."""
    path = shared / "benchmarks" / "silverbox" / "SNLS80mV.csv"
    table = np.genfromtxt(path, delimiter=",", skip_header=1)[:, :2]
    table -= table[:QUIET].mean(axis=0)
    out.mkdir(parents=True, exist_ok=True)
    runs = {name: slice(first, first + LENGTH) for name, first in STARTS.items()} | {"arrow": slice(ARROW)}
    for name, rows in runs.items():
        voltage, position = table[rows].T
        write_columns(out / f"{name}.csv", {"time_s": STEP * np.arange(len(voltage)), "input": voltage, "position": position})
    listed = "".join(f'  {{ file = "{name}.csv", role = "fit" }},\n' for name in STARTS)
    (out / "dataset.toml").write_text(DESCRIPTION.format(runs=listed), encoding="utf-8")

"""Data sets of a soft arm whose bending chamber follows a regulator (`real/smart_pneumatic_arm`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tepm_opt.data.tables import write_columns

NOISE = 1e-4  # m, 1 sigma
TIME, COMMAND, GAUGE, BASE, TOP = 0, 1, 4, slice(7, 10), slice(14, 17)  # columns of a recording
STEPS, CONTACT = "2020_07-30_data_collect_5.txt", ("0115_data_collect_1.txt", "0115_data_collect_2.txt")
DESCRIPTION = """name = "{name}"
{gauges}runs = [
{runs}]
[noise]
x = {noise:g}
y = {noise:g}
"""


def steps(shared: Path, out: Path, column: int = COMMAND) -> None:
    """Steps of the chamber's pressure: the first two thirds of the cycles to fit, the others to validate.

    The run to validate holds the whole recording, without positions where the other has them: both begin at rest.
    """
    table = _recording(shared, STEPS)
    time, command = table[:, TIME], table[:, COMMAND]
    rises = time[1:][np.diff(command) > 1.0]
    early = time < rises[2 * len(rises) // 3] - 0.02
    _write(out / "fit.csv", table[early], column)
    hidden = table.copy()
    hidden[early, TOP] = np.nan
    _write(out / "validation.csv", hidden, column)
    _describe(out, "steps of one chamber", {"fit.csv": "fit", "validation.csv": "validation"}, column)


def steps_by_gauges(shared: Path, out: Path) -> None:
    """The same with what the gauge shows in the place of the command."""
    steps(shared, out, GAUGE)


def contact(shared: Path, out: Path) -> None:
    """The same trial without and with a contact, by the gauge."""
    for file, name in zip(CONTACT, ("free.csv", "touched.csv"), strict=True):
        table = _recording(shared, file)
        table[:, TOP] = table[:, [14, 16, 15]]  # this arm hangs along the second axis
        table[:, BASE] = table[:, [7, 9, 8]]
        _write(out / name, table, GAUGE)
    _describe(out, "a trial without and with contact", {"free.csv": "fit", "touched.csv": "fit"}, GAUGE)


def _recording(shared: Path, file: str) -> np.ndarray:
    lines = (shared / "real" / "smart_pneumatic_arm" / file).read_text(encoding="utf-8").splitlines()
    return np.array([[float(field) for field in line.split("|") if field.strip()] for line in lines])


def _write(path: Path, table: np.ndarray, column: int) -> None:
    x, y = (table[:, TOP] - table[:, BASE].mean(axis=0)).T[:2]
    path.parent.mkdir(parents=True, exist_ok=True)
    write_columns(path, {"time_s": table[:, TIME], "pressure_psi": table[:, column], "x": x, "y": y})


def _describe(out: Path, name: str, runs: dict[str, str], column: int) -> None:
    gauges = 'gauges = ["pressure_psi"]\n' if column == GAUGE else ""
    listed = "".join(f'  {{ file = "{file}", role = "{role}" }},\n' for file, role in runs.items())
    (out / "dataset.toml").write_text(DESCRIPTION.format(name=name, gauges=gauges, runs=listed, noise=NOISE), encoding="utf-8")

"""A plant file of a tank and data sets of such tanks, for tests of commands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tepm_opt.data.run import Run

TANK = """from tepm_opt.discrepancy.adapters.equations import Equations

m = Equations("tank", time=0.5)
level, inflow = m.state("level"), m.input("inflow", size=1.0)
m.rate(level, inflow - m.parameter("leak", 2.0, "1/s", within=WITHIN) * level)
m.output("level", level, "m", size=0.5)
plant = m.plant()
"""


def write_plant(file: Path, within: float) -> Path:
    """Write the plant file; the leak is known to this part of 2 per second."""
    file.write_text(TANK.replace("WITHIN", str(within)))
    return file


def write_tank(folder: Path, measured: Sequence[Run], noise: float) -> Path:
    """Write a data set of levels under inflows; the last run is for validation."""
    folder.mkdir()
    for run in measured:
        rows = zip(run.time, run.inputs[:, 0], run.points[:, 0, 0], strict=True)
        (folder / run.file).write_text("time_s,inflow,level\n" + "".join(f"{t:.6f},{u:.9f},{x:.9f}\n" for t, u, x in rows))
    roles = ["fit"] * (len(measured) - 1) + ["validation"]
    listed = ", ".join(f'{{ file = "{run.file}", role = "{role}" }}' for run, role in zip(measured, roles, strict=True))
    (folder / "dataset.toml").write_text(f'name = "{folder.name}"\nruns = [{listed}]\n[noise]\nlevel = {noise}\n')
    return folder

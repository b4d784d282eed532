"""Driven runs of a tendon trunk with a hidden payload (`real/trunk`): set points of the motors and the tip, 12.5 samples a second."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tepm_opt.data.tables import write_columns

EVERY = 4  # rows of 50 a second: motion ends below 5 Hz
NOISE = 8e-6  # m, of the tracker at rest
COLUMNS = ("time_s", *(f"u{k}" for k in range(1, 7)), "x3", "y3", "z3")


def trunk(shared: Path, out: Path, file: str = "servo/driven_0g.csv", part: tuple[float, float] = (0.0, 1.0)) -> None:
    """A run, or a part of it, in the names of `trunk.py`; it begins as its first samples tell."""
    table = np.genfromtxt(shared / "real" / "trunk" / file, delimiter=",", names=True)
    first, last = (round(share * len(table)) for share in part)
    out.mkdir(parents=True, exist_ok=True)
    name = Path(file).name
    write_columns(out / name, {column: table[column][first:last:EVERY] for column in COLUMNS})
    noise = "\n".join(f"{column} = {NOISE}" for column in COLUMNS[-3:])
    text = f'name = "{Path(file).stem}"\nstart = "measured"\n[noise]\n{noise}\n[[runs]]\nfile = "{name}"\nrole = "fit"\n'
    (out / "dataset.toml").write_text(text, encoding="utf-8")


def payload(grams: int) -> Callable[[Path, Path], None]:
    """What writes the run with a payload in g."""
    return lambda shared, out: trunk(shared, out, f"servo/driven_{grams}g.csv")

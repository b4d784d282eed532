"""The practical limit of a hand-written solver for this robot: medians printed by a `time_limit.py` elsewhere."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

LINES = {
    "warm": "statics, warm",
    "cold": "statics, cold",
    "gain": "G, 3 x 6 in force",
    "midpoint": "midpoint 5 ms, 2 Newton",
    "alpha": "generalised alpha 5 ms, 2",
    "explicit": "RK4 1/3 ms",
}
UNITS = {"us": 1e-6, "ms": 1e-3}
# time_limit.py, then the largest distance in mm of its implicit schemes' tips from those of its RK4
SCRIPT = """
import runpy, numpy
of = runpy.run_path("time_limit.py")
start, lim = (of["rest"], of["v0"], of["F"]), of["lim"]
exact = lim.rk4(*start, 1e-3 / 3, 9000, 60)[3]
for key, scheme in (("midpoint", 1), ("alpha", 3)):
    tips = lim.implicit(*start, 5e-3, 600, 4, scheme, maxit=2, tol=1e-9, refac=1)[3]
    print("error", key, 1e3 * numpy.linalg.norm(tips - exact, axis=1).max(), "mm")
"""


class Limit:
    """Runs of `time_limit.py`, which is copied because its own folder may be read-only.

    Attributes:
        figures: times in s by key of LINES, one a run.
        errors: of its implicit schemes in m, by key.
        absent: why there are no figures; empty where there are.
    """

    def __init__(self, folder: Path | None, scratch: Path) -> None:
        self.figures: dict[str, list[float]] = {key: [] for key in LINES}
        self.errors: dict[str, float] = {}
        self._copy = scratch / "limit"
        self.absent = ""
        if folder is None:
            self.absent = "neither --limit nor TEPM_LIMIT names the folder of time_limit.py"
        elif not (folder / "time_limit.py").is_file():
            self.absent = f"no time_limit.py in {folder}"
        else:
            self._copy.mkdir()
            for path in folder.iterdir():
                if path.is_file():
                    shutil.copyfile(path, self._copy / path.name)

    def run(self) -> None:
        """Run the script once and keep its figures."""
        if self.absent:
            return
        command = [sys.executable, "-c", SCRIPT]
        result = subprocess.run(command, cwd=self._copy, capture_output=True, text=True, check=False)
        found = {key: re.search(rf"^{re.escape(text)}.*? ([0-9.]+) (us|ms)\b", result.stdout, re.MULTILINE) for key, text in LINES.items()}
        if result.returncode or not all(found.values()):
            self.absent = f"time_limit.py failed: {(result.stderr or result.stdout).strip()[-200:]}"
            return
        for key, match in found.items():
            self.figures[key].append(float(match[1]) * UNITS[match[2]])  # type: ignore[index]
        self.errors = {key: 1e-3 * float(error) for key, error in re.findall(r"^error (\w+) ([0-9.e+-]+) mm", result.stdout, re.MULTILINE)}

    def median(self, key: str) -> float:
        """Median over the runs in s; NaN where there is no figure."""
        figures = [] if self.absent else self.figures.get(key, [])
        return float(np.median(figures)) if figures else np.nan

"""The practical limit of a hand-written solver for this robot: medians printed by a `time_limit.py` elsewhere."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

LINES = {"warm": "statics, warm", "cold": "statics, cold", "gain": "G, 3 x 6 in force"}


class Limit:
    """Runs of `time_limit.py`, which is copied because its own folder may be read-only.

    Attributes:
        absent: why there are no figures; empty where there are.
    """

    def __init__(self, folder: Path | None, scratch: Path) -> None:
        self.figures: dict[str, list[float]] = {key: [] for key in LINES}
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
        command = [sys.executable, "time_limit.py"]
        result = subprocess.run(command, cwd=self._copy, capture_output=True, text=True, check=False)
        found = {key: re.search(rf"^{re.escape(text)}.*?([0-9.]+) us", result.stdout, re.MULTILINE) for key, text in LINES.items()}
        if result.returncode or not all(found.values()):
            self.absent = f"time_limit.py failed: {(result.stderr or result.stdout).strip()[-200:]}"
            return
        for key, match in found.items():
            self.figures[key].append(float(match[1]) * 1e-6)  # type: ignore[index]

    def median(self, key: str) -> float:
        """Median over the runs in s; NaN where there is no figure."""
        figures = [] if self.absent else self.figures.get(key, [])
        return float(np.median(figures)) if figures else np.nan

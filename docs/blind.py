"""Write the table and figures of docs/results/blind.md from a finished `tepm study blind`.

Run: python docs/blind.py FOLDER, the folder that --out named.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

DOCS = Path(__file__).parent
BEGIN, END = "<!-- table -->", "<!-- end of the table -->"
FIGURES = {
    "rates": "Rates with their intervals and the limits they shall keep",
    "detection": "How often a single effect is found, against the misfit it leaves",
    "reliability": "Stated probabilities against how often they are right",
    "confusion": "What is said of what is hidden",
}


def main(folder: Path) -> None:
    """Put what a run says between the page's marks, and its figures into docs/images."""
    asked = json.loads((folder / "summary.json").read_text(encoding="utf-8"))["blind"]["asked"]
    only = f" --family {asked['family']}" if asked["family"] else ""
    lines = [f"`tepm study blind --trials {asked['trials']} --seed {asked['seed']}{only}`, version {asked['version']}:", ""]
    lines += [(folder / "summary.md").read_text(encoding="utf-8").rstrip(), ""]
    for name, title in FIGURES.items():
        if (folder / f"{name}.png").exists():
            shutil.copy(folder / f"{name}.png", DOCS / "images" / f"blind_{name}.png")
            lines += [f"![{title}](../images/blind_{name}.png)", ""]
    page = DOCS / "results" / "blind.md"
    before, rest = page.read_text(encoding="utf-8").split(BEGIN)
    page.write_text("\n".join([f"{before}{BEGIN}", *lines, END + rest.split(END)[1]]), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))

"""Run the notebooks and store them with what they show: `python docs/notebooks.py [NOTEBOOK …]`; `03` stands for the one that begins so."""

from __future__ import annotations

import hashlib
import json
import os
import re
import sys
from base64 import b64decode, b64encode
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import nbformat
from nbformat import NotebookNode
from PIL import Image

from tepm_opt.data.files import write_atomically

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
NOTEBOOKS = tuple(sorted(FOLDER.glob("*.ipynb")))
LARGEST = 300_000  # bytes of a notebook
DPI, COLOURS = 85, 96  # of a figure
PLACES = re.compile(r"(?<![\w./<])/(?:tmp|root|home|Users|var|work|opt|usr)/\S*")
"""Folders of the machine that ran a notebook."""


def run(path: Path, folder: Path) -> NotebookNode:
    """A notebook, run from top to bottom in a folder; an exception in a cell, such as a failed assertion, comes through."""
    from nbclient import NotebookClient  # of the extra dev

    notebook = nbformat.read(path, as_version=4)
    settings: dict[str, Any] = {"kernel_name": "python3", "timeout": 600, "record_timing": False, "coalesce_streams": True}
    settings["extra_arguments"] = [f"--InlineBackend.print_figure_kwargs={{'dpi': {DPI}}}"]
    NotebookClient(notebook, resources={"metadata": {"path": str(folder)}}, **settings).execute()
    return notebook


def code(notebook: NotebookNode) -> list[NotebookNode]:
    """Its cells that are run."""
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def digest(notebook: NotebookNode) -> str:
    """SHA-256 of all that is run: who changes a cell has to store the notebook anew."""
    return hashlib.sha256(json.dumps([cell.source for cell in code(notebook)]).encode()).hexdigest()


def finish(notebook: NotebookNode) -> None:
    """Make small figures of those of a notebook that was run, and note which code was run; nothing tells of the machine."""
    for cell in code(notebook):
        for output in cell.outputs:
            if "image/png" in output.get("data", {}):
                output.data["image/png"] = b64encode(smaller(b64decode(output.data["image/png"]))).decode()
                output.metadata = NotebookNode()
    notebook.metadata.language_info = NotebookNode(name="python")
    notebook.metadata["code_sha256"] = digest(notebook)


def smaller(png: bytes) -> bytes:
    """A figure on white with a palette instead of four bytes a pixel."""
    picture = Image.open(BytesIO(png)).convert("RGBA")
    picture = Image.alpha_composite(Image.new("RGBA", picture.size, "white"), picture).convert("RGB")
    stored = BytesIO()
    picture.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=1, dither=Image.Dither.NONE).save(stored, "PNG", optimize=True)
    return stored.getvalue()


def faults(notebook: NotebookNode) -> list[str]:
    """What is wrong with a notebook as it is stored; nothing, if it may be."""
    cells = code(notebook)
    outputs = [output for cell in cells for output in cell.outputs]
    found = []
    if [cell.execution_count for cell in cells] != list(range(1, len(cells) + 1)):
        found.append("not run from top to bottom")
    if notebook.metadata.get("code_sha256") != digest(notebook):
        found.append("code changed since it was run")
    if not any("image/png" in output.get("data", {}) for output in outputs):
        found.append("no figure")
    found += [f"error: {output.ename}" for output in outputs if output.output_type == "error"]
    found += [f"on stderr: {output.text}" for output in outputs if output.get("name") == "stderr"]
    found += [f"a path of this machine: {place}" for output in outputs for text in texts(output) for place in PLACES.findall(text)]
    if (size := len(nbformat.writes(notebook).encode())) > LARGEST:
        found.append(f"{size} bytes, more than {LARGEST}")
    return found


def texts(output: NotebookNode) -> Iterator[str]:
    """All that an output says in words."""
    yield output.get("text", "")
    yield from ("".join(value) for kind, value in output.get("data", {}).items() if kind.startswith("text/"))


def store(path: Path) -> list[str]:
    """Run a notebook in an empty folder and store it; what is wrong with it if it was not stored."""
    with TemporaryDirectory() as folder:
        notebook = run(path, Path(folder))
    finish(notebook)
    found = faults(notebook)
    if not found:
        write_atomically(path, nbformat.writes(notebook) + "\n")
    return found


def main(names: list[str]) -> int:
    """Store the notebooks that are named, or all; the exit status is 1 if one was not stored."""
    os.environ.pop("TEPM_SHARED", None)  # notebook 06 shows what everybody has
    if unknown := [name for name in names if not any(path.stem.startswith(name) for path in NOTEBOOKS)]:
        print("no notebook begins with", *unknown)
        return 1
    bad = False
    for path in NOTEBOOKS:
        if not names or path.stem.startswith(tuple(names)):
            found = store(path)
            print(path.name, "not stored: " + "; ".join(found) if found else f"{path.stat().st_size / 1e3:.0f} kB", flush=True)
            bad |= bool(found)
    return int(bad)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

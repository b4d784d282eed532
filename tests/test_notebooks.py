"""Every notebook runs from top to bottom in an empty folder, and is stored with what it shows."""

from __future__ import annotations

import re
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import nbformat
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from nbformat import NotebookNode
from PIL import Image

from docs.notebooks import LARGEST, NOTEBOOKS, code, faults, finish, run, smaller
from tests.hw import emulator

SAME_WORDS = ("01", "02", "05")
"""Those that say the same on every machine, but for digits; verdicts may name other rivals where the last digits differ."""


def read(path: Path) -> NotebookNode:
    """A notebook as it is stored."""
    return nbformat.read(path, as_version=4)


def test_there_are_notebooks() -> None:
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_stored_as_it_was_run(path: Path) -> None:
    """Valid, with cell ids and the kernel `python3`; run in order, with figures, small, of no particular machine; its last cell asserts."""
    notebook = read(path)
    nbformat.validate(notebook)
    assert notebook.metadata.kernelspec.name == "python3"
    assert notebook.metadata.language_info == {"name": "python"}
    ids = [cell.get("id") for cell in notebook.cells]
    assert all(ids)
    assert len(set(ids)) == len(ids)
    assert "assert" in code(notebook)[-1].source
    assert faults(notebook) == [], f"`python docs/notebooks.py {path.stem[:2]}` stores it anew"


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without an exception, and it shows what is stored."""
    pytest.importorskip("nbclient", reason="nbclient is not installed (extra dev)")
    monkeypatch.setenv("PYTHONWARNINGS", "ignore:no C compiler")
    stored, notebook = read(path), run(path, tmp_path)
    finish(notebook)
    assert faults(notebook) == []
    assert list(tmp_path.iterdir()) == [], "a notebook leaves nothing behind"
    if not (path.stem.startswith("04") and emulator.missing()):
        assert figures(notebook) == figures(stored)
    if path.stem[:2] in SAME_WORDS:
        assert words(notebook) == words(stored)


def figures(notebook: NotebookNode) -> list[int]:
    """How many figures each cell shows."""
    return [sum("image/png" in output.get("data", {}) for output in cell.outputs) for cell in code(notebook)]


def words(notebook: NotebookNode) -> list[list[str]]:
    """What each cell prints, without numbers and the spaces that align them."""
    number = re.compile(r"[-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
    return [number.sub(" ", "".join(output.get("text", "") for output in cell.outputs)).split() for cell in code(notebook)]


def say(cell: NotebookNode, text: str, name: str = "stdout") -> None:
    """Let a cell have printed something else."""
    cell.outputs = [nbformat.v4.new_output("stream", name=name, text=text)]


SPOILT: dict[str, Callable[[list[NotebookNode]], object]] = {
    "not run from top to bottom": lambda cells: cells[1].update(execution_count=7),
    "code changed since it was run": lambda cells: cells[1].update(source=f"{cells[1].source} "),
    "no figure": lambda cells: [cell.update(outputs=[]) for cell in cells],
    "error: ValueError": lambda cells: cells[1].outputs.append(
        nbformat.v4.new_output("error", ename="ValueError", evalue="", traceback=[])
    ),
    "on stderr: careful": lambda cells: say(cells[1], "careful", "stderr"),
    "a path of this machine: /tmp/tmpx/a.csv:": lambda cells: say(cells[1], "see /tmp/tmpx/a.csv: line 3"),
    f"more than {LARGEST}": lambda cells: say(cells[1], LARGEST * "x"),
}


@pytest.mark.parametrize("fault", SPOILT)
def test_what_may_not_be_stored_is_seen(fault: str) -> None:
    notebook = read(NOTEBOOKS[0])
    SPOILT[fault](code(notebook))
    (found,) = faults(notebook)
    assert fault in found


def test_ordinary_words_are_no_paths() -> None:
    notebook = read(NOTEBOOKS[0])
    say(code(notebook)[1], "1/s and m/N, and/or <b>3</b>, docs/tmp/x, N/work, https://example.org/home/x")
    assert faults(notebook) == []


def test_a_small_figure_looks_the_same() -> None:
    """Also a dot of a colour of its own; white stays white."""
    figure = Figure(figsize=(6, 4))
    panels = figure.subplots(1, 2)
    panels[0].imshow(np.random.default_rng(0).normal(size=(20, 20)), cmap="RdBu_r")
    for k in range(6):
        panels[1].plot([0, 1], [k, k + 1], color=f"C{k}")
    panels[1].plot(0.5, 3, ".", color="magenta", markersize=4)
    drawn = BytesIO()
    FigureCanvasAgg(figure).print_png(drawn)
    png = smaller(drawn.getvalue())
    before, after = (np.asarray(Image.open(BytesIO(each)).convert("RGB"), dtype=int) for each in (drawn.getvalue(), png))
    assert len(png) < 0.6 * len(drawn.getvalue())
    assert after.shape == before.shape
    assert np.abs(after - before).mean() < 1
    assert np.abs(after - before).max() < 40
    assert (after[0, 0] == 255).all()

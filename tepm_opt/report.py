"""One self-contained HTML page about the main job."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

import jinja2
import numpy as np

from tepm_opt.data.files import write_atomically
from tepm_opt.runs import GainRun, IkRun


def write_page(path: str | Path, hybrid: IkRun, pressure: IkRun, gains: GainRun, figures: Mapping[str, Path]) -> None:
    """Write the page; `figures` are PNG files by name ("ik", "gain"), put into it.

    Raises:
        InputError: the folder cannot be written to.
    """
    environment = jinja2.Environment(loader=jinja2.PackageLoader("tepm_opt"), autoescape=True, undefined=jinja2.StrictUndefined)
    images = {name: base64.b64encode(file.read_bytes()).decode() for name, file in figures.items()}
    found = [gain for gain in gains.gains if gain]
    spans = {
        kind: [float(1e3 * function([gain.singular_values(kind)[at] for gain in found])) for function, at in ((np.min, 2), (np.max, 0))]
        for kind in ("pressure", "tension")
        if found
    }
    page = environment.get_template("demo.html").render(
        robot=hybrid.model.robot,
        values=hybrid.model.values,
        hybrid=hybrid.summary(),
        pressure=pressure.summary(),
        images=images,
        spans=spans,
        version=version("tepm-opt"),
    )
    write_atomically(path, page)

"""Effects as the search for unknown laws writes them, one of each kind of hook."""

from __future__ import annotations

import numpy as np

from tepm_opt.discrepancy.symbolic.curves import Lags, Powers
from tepm_opt.discrepancy.symbolic.formula import Formula
from tepm_opt.discrepancy.symbolic.places import Place
from tepm_opt.discrepancy.symbolic.terms import Term, Terms
from tepm_opt.discrepancy.symbolic.writing import write
from tepm_opt.models.effect import Effect
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import load_robot

ROBOT = load_robot("kang2017")
FORMULAS: tuple[Formula, ...] = tuple(
    Formula(place, tuple(range(first, first + len(sizes))), np.array(sizes), np.zeros(len(sizes)), 1.0, 1.0)
    for place, sizes, first in (
        (Place("axial", "all", "pressure", Terms((Term("saturation", 3e4),), 3e5)), (-0.5,), 0),
        (Place("axial", "13", "pressure", Terms((Term("linear"), Term("quadratic")), 3e5)), (0.4, -0.6), 0),
        (Place("axial", "all", "length", Terms((Term("cubic"),), 0.03)), (-0.5,), 0),
        (Place("axial", "all", "supply", Terms((Term("ramp", 1e5),), 3e5), times="pressure", most=3e5), (-1.0,), 0),
        (Place("axial", "21", "pressure", Lags((0.1,), 3e5), "late"), (5.0,), 0),
        (Place("measurement", "s3", "position", Powers((0.0, 0.0, 0.2), (0.1, 0.1, 0.1), 1)), (2e-3, 1e-3), 0),
        (Place("force", "s3", "speed", Powers((), (), 0), most=0.2), (0.1,), 2),
    )
)


def written() -> tuple[Effect, ...]:
    """The effects of the files."""
    found = []
    for formula in FORMULAS:
        made: dict = {"__name__": "law"}
        exec(compile(write(formula, Layout.from_robot(ROBOT), ROBOT.parameters.A, "a test").text, "law.py", "exec"), made)
        kinds = [kind for kind in made.values() if isinstance(kind, type) and issubclass(kind, Effect) and kind.__module__ == "law"]
        found += [kind() for kind in kinds]
    return tuple(found)

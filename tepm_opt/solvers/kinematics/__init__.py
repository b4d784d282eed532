"""Tip positions to axial forces to set points, and constant-curvature kinematics both ways."""

from __future__ import annotations

from typing import Any

from tepm_opt.renamed import find_renamed

_RENAMED = {
    "Configuration": "ik.Configuration",
    "IkSettings": "ik_problem.IkSettings",
    "each_configuration": "ik.each_configuration",
    "solve_ik": "ik.solve_ik",
    "solve_trajectory": "ik.solve_trajectory",
}


def __getattr__(name: str) -> Any:
    """Name of the former module `solvers.kinematics`."""
    return find_renamed(__name__, name, _RENAMED)

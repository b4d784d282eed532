"""Small motions about an equilibrium: gain, state space, modes, models of few states."""

from __future__ import annotations

from typing import Any

from tepm_opt.renamed import find_renamed

_RENAMED = {"Linear": "state_space.Linear", "linearise": "state_space.linearise"}


def __getattr__(name: str) -> Any:
    """Name of the former module `solvers.linear`."""
    return find_renamed(__name__, name, _RENAMED)

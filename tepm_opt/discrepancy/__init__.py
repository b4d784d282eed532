"""The discrepancy workflow: find the gap between model and data, name the missing effect, add it, show the gap shrink.

Rooms: `pipeline` (the stages), `problem`, `preparation`, `selection`, `assessment`, `experiments`, `adapters` (plants), `laws`, `symbolic`
(laws that no library has) and `reporting`.
"""

from __future__ import annotations

from tepm_opt.renamed import rename_modules

rename_modules(
    __name__,
    {
        **{name: f"adapters.{name}" for name in ("equations", "callable_plant", "casadi_plant", "network")},
        "library": "laws.*",
        "workflow": "pipeline",
    },
)

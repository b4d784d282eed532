"""Model-based control and trajectory optimisation of continuum robots made of pneumatic muscles with embedded tendons.

from tepm_opt import circle, compile_model, solve_gain, solve_ik, solve_statics

model = compile_model("kang2017")
found = solve_ik(model, [0.15, 0.0, 0.35])
held = solve_statics(model, found.allocation.inputs)
G = solve_gain(held).matrix

`run_<name>` does what the command `tepm <name>` does; the run it returns has `ok`, `summary()` and `save(folder)`, and `plots.draw`
draws its figures. All names are listed in `__init__.pyi`; the project's own studies are in `tepm_opt.studies`.
"""

import lazy_loader

_get_listed, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

RENAMED = {
    "BlindRun": "studies.BlindRun",
    "Closing": "ModelUpdate",
    "Family": "studies.Family",
    "MachinesRun": "studies.MachinesRun",
    "balanced": "balanced_reduction",
    "run_blind": "studies.run_blind",
    "run_close": "run_model_update",
    "run_machines": "studies.run_machines",
    "run_study": "studies.run_study",
    "write_blind_page": "studies.write_blind_page",
    "write_closing_page": "write_model_update_page",
    "write_paper_page": "studies.write_paper_page",
}
"""New names by the old ones, which work until version 0.4."""


def __getattr__(name: str) -> object:
    """Name of the package, imported now; a name of an earlier version gives the renamed object with a DeprecationWarning.

    Raises:
        AttributeError: no such name.
    """
    if name not in RENAMED:
        return _get_listed(name)
    from tepm_opt.renamed import find_renamed

    return find_renamed(__name__, name, RENAMED)

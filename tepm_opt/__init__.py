"""Model-based control and trajectory optimisation of continuum robots made of pneumatic muscles with embedded tendons.

from tepm_opt import circle, compile_model, solve_gain, solve_ik, solve_statics

model = compile_model("kang2017")
found = solve_ik(model, [0.15, 0.0, 0.35])
held = solve_statics(model, found.allocation.inputs)
G = solve_gain(held).matrix

`run_<name>` does what the command `tepm <name>` does; the run it returns has `ok`, `summary()` and `save(folder)`, and `plots.draw`
draws its figures. All names are listed in `__init__.pyi`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Studies of the project itself: blind trials of verdicts, the paper's experiments, a controller on random machines.

Each has a `run_<name>`, whose run has `ok`, `summary()` and `save(folder)`, and a function that draws its figures into a folder. The
commands `tepm study <name>` do the same. All names are listed in `__init__.pyi`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

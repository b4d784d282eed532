"""Figures of runs: `draw` draws all figures of a run into a folder; the others make one each, to be shown or saved."""

from tepm_opt import lazy

__getattr__, __dir__, __all__ = lazy.attach(__name__, __file__)

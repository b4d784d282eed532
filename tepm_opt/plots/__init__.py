"""Figures of runs: `draw` draws all figures of a run into a folder; the others make one each, to be shown or saved."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

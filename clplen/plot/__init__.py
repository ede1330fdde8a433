"""Figures of fields, raw images, views, stacks, depth and optical systems (no display needed).

Every function returns a `matplotlib.figure.Figure`; `save` writes it to a file. The colour scale is
linear unless the colour bar names another.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)

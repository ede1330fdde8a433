"""Figures of fields, raw images, views, stacks, depth and optical systems (no display needed).

Every function returns a `matplotlib.figure.Figure`; `save` writes it. Values are shown linearly
unless the colour bar says otherwise.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)

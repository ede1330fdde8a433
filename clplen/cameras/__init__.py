"""Scenes, and the plenoptic cameras and microscopes that take raw images of them."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)

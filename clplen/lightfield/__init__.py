"""Light fields: raw images and their lattices, views, refocus, focal stacks, depth, streaming."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)

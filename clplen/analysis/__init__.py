"""Image quality: point spread, transfer, depth scores, and comparisons of cameras."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)

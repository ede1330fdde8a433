"""Benchmarks of a device against its ceilings, with helpers for benchmark scripts."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)

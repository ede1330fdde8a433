"""Operators of clplen in programs of PyTorch, with gradients; imported when it is asked for."""

from importlib.util import find_spec

from lazy_loader import attach_stub

if find_spec("torch") is None:
    raise ModuleNotFoundError(
        'clplen.torch needs PyTorch, which is not installed: pip install "clplen[torch]".',
        name="torch",
    )
__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)

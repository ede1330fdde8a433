"""Operators of clplen with gradients for PyTorch."""

from importlib.util import find_spec

from lazy_loader import attach_stub

from clplen.checks import install_advice

if find_spec("torch") is None:
    raise ModuleNotFoundError(
        f"clplen.torch needs PyTorch, which is not installed: {install_advice('torch')}.",
        name="torch",
    )
__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)

"""Operators of clplen in programs of JAX, with gradients; imported when it is asked for."""

from importlib.util import find_spec

from lazy_loader import attach_stub

if find_spec("jax") is None:
    raise ModuleNotFoundError(
        'clplen.jax needs JAX, which is not installed: pip install "clplen[jax]".', name="jax"
    )
__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)

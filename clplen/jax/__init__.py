"""Operators of clplen with gradients for JAX."""

from importlib.util import find_spec

from lazy_loader import attach_stub

from clplen.checks import install_advice

if find_spec("jax") is None:
    raise ModuleNotFoundError(
        f"clplen.jax needs JAX, which is not installed: {install_advice('jax')}.", name="jax"
    )
__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)

"""Warnings that point to the line outside this package that led to them."""

from __future__ import annotations

import sys
import warnings

_PACKAGE = __name__.partition(".")[0]
_TRANSPARENT = ("functools", "contextlib")  # their wrappers stand between functions of the package


def warn_caller(message: str, category: type[Warning]) -> None:
    """Warn from the line outside the package that led here.

    Parameters
    ----------
    message : str
    category : type of Warning
    """
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and _is_skipped(frame.f_globals.get("__name__", "")):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, category, stacklevel=level)


def _is_skipped(module: str) -> bool:
    return module.partition(".")[0] == _PACKAGE or module in _TRANSPARENT

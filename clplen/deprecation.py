"""Warnings that point to the caller's line, and old names of arguments and attributes."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from functools import wraps
from inspect import Parameter, signature
from typing import Any, TypeVar

_PACKAGE = __name__.partition(".")[0]
Target = TypeVar("Target", bound=Callable[..., Any])


def warn_caller(message: str, category: type[Warning]) -> None:
    """Warn from the line outside the package that led here.

    Parameters
    ----------
    message : str
    category : type of Warning
    """
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and _is_inside(frame.f_globals.get("__name__", "")):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, category, stacklevel=level)


def renamed_argument(old: str, new: str, *, warn: bool = True) -> Callable[[Target], Target]:
    """Decorate a function or class that still takes an argument by its old keyword.

    Parameters
    ----------
    old, new : str
        Keywords. The signature that is shown has the new one only.
    warn : bool
        Whether the old one is a `DeprecationWarning` at the caller's line.

    Returns
    -------
    callable
        The decorator. Both keywords in one call are a `TypeError`.

    Examples
    --------
    >>> @renamed_argument(old="f", new="focal_length")
    ... def power(focal_length):
    ...     return 1 / focal_length
    """

    def decorate(target: Target) -> Target:
        if isinstance(target, type):
            target.__init__ = decorate(target.__init__)  # type: ignore[misc]
            return target
        name = target.__qualname__.removesuffix(".__init__")
        position = _position(target, new)

        @wraps(target)
        def renamed(*arguments: Any, **keywords: Any) -> Any:
            if old in keywords:
                if new in keywords or len(arguments) > position:
                    raise TypeError(f"{name}() got {new} twice: {old}= is its old name.")
                if warn:
                    message = f"{name}() takes {new}=; its old name {old}= is deprecated."
                    warn_caller(message, DeprecationWarning)
                keywords[new] = keywords.pop(old)
            return target(*arguments, **keywords)

        return renamed  # type: ignore[return-value]

    return decorate


def renamed_attribute(old: str, new: str, *, warn: bool = True) -> Any:
    """A property that reads an attribute by its old name.

    Parameters
    ----------
    old, new : str
    warn : bool
        Whether the old name is a `DeprecationWarning` at the caller's line.

    Returns
    -------
    property

    Examples
    --------
    >>> class Mirror:
    ...     focal_length = 0.1
    ...     f = renamed_attribute("f", "focal_length")
    """

    def read(self: Any) -> Any:
        if warn:
            message = f"{type(self).__name__}.{old} is deprecated: read .{new}."
            warn_caller(message, DeprecationWarning)
        return getattr(self, new)

    return property(read, doc=f"The old name of ``{new}``.")


def _is_inside(module: str) -> bool:
    """Whether a frame is the package's, or one of the wrappers of the standard library."""
    return module.partition(".")[0] in (_PACKAGE, "contextlib", "functools")


def _position(function: Callable[..., Any], name: str) -> int:
    """Index of a parameter among the positional ones; no index reaches a keyword-only one."""
    parameters = list(signature(function).parameters.values())
    index = [parameter.name for parameter in parameters].index(name)
    return sys.maxsize if parameters[index].kind is Parameter.KEYWORD_ONLY else index

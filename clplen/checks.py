"""Checks that every room shares."""

from __future__ import annotations

from typing import Any


def require(kind: type, value: Any, what: str, source: str) -> None:
    """Refuse what is not of a kind, with what gives one.

    Raises
    ------
    TypeError
    """
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIO" else "a"
        raise TypeError(
            f"{what} is {article} {kind.__name__}, as {source} gives it, not of type "
            f"{type(value).__name__}."
        )

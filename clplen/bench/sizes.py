"""Sizes of benchmarks as text: 15x15x434x625x3."""

from __future__ import annotations

import re

from clplen.errors import ShapeError


def numbers(size: str, counts: tuple[int, ...], form: str) -> tuple[int, ...]:
    """The whole numbers of a size.

    Parameters
    ----------
    size : str
    counts : tuple of int
        How many there may be.
    form : str
        What a size looks like, for the message.

    Raises
    ------
    ShapeError
        If it is something else.
    """
    if not re.fullmatch(r"[1-9]\d*(x[1-9]\d*)*", size) or size.count("x") + 1 not in counts:
        raise ShapeError(f"A size of this benchmark is {form}, not {size!r}.")
    return tuple(int(n) for n in size.split("x"))


def halved(size: str, axes: tuple[int, ...], least: int) -> str:
    """The size with some of its numbers halved; nothing where one would fall below ``least``."""
    found = [int(n) for n in size.split("x")]
    for axis in axes:
        found[axis] //= 2
    return "x".join(map(str, found)) if min(found[axis] for axis in axes) >= least else ""

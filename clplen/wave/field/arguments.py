"""Checks of arguments that several elements and systems share."""

from __future__ import annotations

from typing import Literal

import numpy as np

from clplen import units
from clplen.checks import is_finite
from clplen.deprecation import warn_caller
from clplen.errors import SamplingError, SamplingWarning

Aliasing = Literal["raise", "warn", "allow"]


def check_centre(centre: tuple[float, float], what: str) -> None:
    """Refuse a centre that is not two finite numbers.

    Raises
    ------
    ValueError
    """
    if np.shape(centre) != (2,) or not np.isfinite(centre).all():
        raise ValueError(f"The centre of {what} is finite, (y, x) in metres, not {centre!r}.")


def check_diameter(diameter: float | None) -> None:
    """Refuse a diameter that is not positive; None is none.

    Raises
    ------
    ValueError
    """
    if diameter is not None and not (is_finite(diameter) and diameter > 0):
        raise ValueError(f"A diameter is positive, in metres, not {diameter!r}.")
    units.DIAMETER.check(diameter, "A diameter")


def check_aliasing(aliasing: str) -> None:
    """Refuse a word that says nothing about aliasing.

    Raises
    ------
    ValueError
    """
    if aliasing not in ("raise", "warn", "allow"):
        raise ValueError(f"aliasing is 'raise', 'warn' or 'allow', not {aliasing!r}.")


def act_on_aliasing(message: str, aliasing: Aliasing) -> None:
    """Raise, warn or go on, where ``message`` is not empty.

    Raises
    ------
    SamplingError
        Where there is a message and ``aliasing`` is "raise".
    ValueError
        If ``aliasing`` is none of the three words.

    Warns
    -----
    SamplingWarning
        Where there is a message and ``aliasing`` is "warn".
    """
    check_aliasing(aliasing)
    if message and aliasing == "raise":
        raise SamplingError(message + " aliasing='warn' or 'allow' goes on all the same.")
    if message and aliasing == "warn":
        warn_caller(message, SamplingWarning)

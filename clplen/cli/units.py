"""Lengths with units, pairs of them, and shapes, as they are typed."""

from __future__ import annotations

import re
from typing import Any, Literal, NoReturn

import click

POWER_OF_TEN = {
    "pm": -12,
    "nm": -9,
    "um": -6,
    "\u00b5m": -6,  # micro sign
    "\u03bcm": -6,  # Greek mu
    "mm": -3,
    "cm": -2,
    "m": 0,
    "km": 3,
}
SHORTEST, LONGEST = 1e-12, 1e12  # metres
LARGEST_SIDE = 10**6  # samples
Sign = Literal["any", "positive", "not 0"]

_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+))(?:[eE]([+-]?\d{1,9}))?\s*(\S*)\s*")
_BETWEEN = re.compile(r"[x\u00d7]")


class Length(click.ParamType):
    """A length in metres from 6.6um, 550nm, 24cm; a bare number is metres."""

    name = "LENGTH"

    def __init__(self, sign: Sign = "any") -> None:
        self.sign = sign

    def get_metavar(self, param: Any, ctx: Any = None) -> str:
        return self.name  # as it is: x is no X

    def convert(self, value: Any, param: Any, ctx: Any) -> float:
        if isinstance(value, float):
            return value
        return self._read(str(value), "", param, ctx)

    def _read(self, text: str, unit: str, param: Any, ctx: Any) -> float:
        """One length; ``unit`` is that of a bare number."""
        found = _NUMBER.fullmatch(text)
        power = POWER_OF_TEN.get((found[3] or unit or "m") if found else "")
        if not found or power is None:
            self._refuse(text, param, ctx)
        exponent = int(found[2] or 0) + power  # so that 6.6um is 6.6e-6 to the last bit
        length = float(f"{found[1]}e{exponent}")
        if length and not SHORTEST <= abs(length) <= LONGEST:
            self.fail(f"{text!r} is out of range: a length is 1 pm to 1e12 m, or 0.", param, ctx)
        if (self.sign == "positive" and length <= 0) or (self.sign == "not 0" and length == 0):
            self.fail(f"{text!r} is not allowed here: the length is {self.sign}.", param, ctx)
        return length

    def _refuse(self, text: str, param: Any, ctx: Any) -> NoReturn:
        comma = "a decimal point, not a comma, and " if "," in text else ""
        self.fail(
            f"{text!r} is no length: give {comma}a number with a unit, as 6.6um, 550nm or 240mm; "
            f"the units are {', '.join(filter(str.isascii, POWER_OF_TEN))}, and a bare number is "
            "metres.",
            param,
            ctx,
        )


class Lengths(Length):
    """(y, x) lengths in metres from YxX, 5umx6.6um or 5x6.6um; one length is both."""

    name = "LENGTH or YxX"

    def __init__(self, sign: Sign = "any", *, one: bool = True) -> None:
        super().__init__(sign)
        self.one = one
        if not one:
            self.name = "YxX"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if isinstance(value, tuple):
            return value
        parts = _BETWEEN.split(str(value))
        if len(parts) > 2 or (len(parts) == 1 and not self.one):
            self.fail(f"{value!r} is no pair YxX: give y and x, as 0x5mm.", param, ctx)
        last = _NUMBER.fullmatch(parts[-1])
        unit = last[3] if last else ""
        lengths = [self._read(part, unit, param, ctx) for part in parts]
        return (lengths[0], lengths[-1])


class Shape(click.ParamType):
    """(ny, nx) samples from N or NYxNX."""

    name = "N or NYxNX"

    def get_metavar(self, param: Any, ctx: Any = None) -> str:
        return self.name

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if isinstance(value, tuple):
            return value
        parts = [part.strip() for part in _BETWEEN.split(str(value))]
        if len(parts) > 2 or not all(part.isascii() and part.isdigit() for part in parts):
            self.fail(
                f"{value!r} is no number of samples: give a whole number, 3030, or rows and "
                "columns, 2048x3030.",
                param,
                ctx,
            )
        sides = [int(part) for part in parts]
        if not all(1 <= side <= LARGEST_SIDE for side in sides):
            self.fail(
                f"{value!r} is out of range: a side has 1 to {LARGEST_SIDE:,} samples.", param, ctx
            )
        return (sides[0], sides[-1])

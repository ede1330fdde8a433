"""Types and options of several commands: planes, lengths with units, sizes, layouts."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NoReturn

import click
import numpy as np

from clplen.cli.shared.setting_options import Command as Command
from clplen.cli.shared.setting_options import Decorated, Option, setting_options
from clplen.settings.declaration import DEVICE, OUTPUT, format_value
from clplen.settings.light_fields import (
    ApertureSettings,
    PlaneSettings,
    StackSettings,
    planes_of,
)
from clplen.settings.reading import ReadingSettings, size_of


class _Parsed(click.ParamType):
    """Value parsed by a function whose ValueError states the condition."""

    read: Callable[[Any], Any]

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return the parsed value, or fail with the function's message."""
        try:
            return type(self).read(value)
        except ValueError as error:
            self.fail(f"{error}, got {format_value(value)}.", param, ctx)


class Planes(_Parsed):
    """Planes from START:STOP:N: N values, both ends included."""

    name = "START:STOP:N"

    @staticmethod
    def read(value: Any) -> np.ndarray[Any, Any]:
        """Return the planes as an array."""
        return np.array(planes_of(value))


class Size(_Parsed):
    """Number of bytes, with or without a unit."""

    name = "SIZE"

    @staticmethod
    def read(value: Any) -> int:
        """Return the number of bytes, at least 1."""
        return size_of(value)


source = click.argument("source", metavar="INPUT", type=click.Path(path_type=Path))


def file(*names: str, help: str, metavar: str = "FILE") -> Callable[[Decorated], Decorated]:
    """Return an optional option that takes a file."""
    return click.option(*names, metavar=metavar, type=click.Path(path_type=Path), help=help)


def output(metavar: str, help: str = "") -> Callable[[Decorated], Decorated]:
    """Return the option for the output file or folder of a command."""
    attributes: Any = {"metavar": metavar, "type": click.Path(path_type=Path), "required": True}
    return click.option("-o", "--output", help=help, **attributes)


def planes(count: int) -> str:
    """Return a count of planes as text."""
    return f"{count:,} plane" + ("" if count == 1 else "s")


class Finite(click.ParamType):
    """Finite number."""

    name = "FLOAT"

    def convert(self, value: Any, param: Any, ctx: Any) -> float:
        try:
            number = float(value)
        except ValueError:
            number = float("nan")
        if not np.isfinite(number):
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        return number


FINITE = Finite()


def _with_options(*options: Any) -> Callable[[Any], Any]:
    def add(command: Any) -> Any:
        for option in reversed(options):
            command = option(command)
        return command

    return add


device = click.option(
    "--device",
    "selector",
    metavar="DEVICE",
    default=None,
    cls=Option,
    group=DEVICE,
    help="OpenCL device: cpu, gpu, platform:device (0:1) or part of a name; 'clplen devices' "
    "lists them. Default: $CLPLEN_DEVICE, else the first GPU, else the first CPU.",
)
memory = click.option(
    "--memory",
    type=Size(),
    cls=Option,
    group=DEVICE,
    help="Memory limit on host and device together (512MiB, 4GB); the light field is processed in "
    "tiles. Default: no limit, the light field is read at once.",
)
force_output = click.option(
    "--force",
    is_flag=True,
    cls=Option,
    group=OUTPUT,
    help="Overwrite outputs that clplen did not write.",
)
force = click.option(
    "--force",
    is_flag=True,
    cls=Option,
    group=OUTPUT,
    help="Overwrite outputs that clplen did not write, and accept a white image whose lattice is "
    "uncertain.",
)
layout = _with_options(setting_options(ReadingSettings, leave_out=("force",)), force)
plane_range = setting_options(PlaneSettings)
aperture = setting_options(ApertureSettings, "aperture")
interpolation = setting_options(StackSettings, "interpolation")


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
MIN_LENGTH, MAX_LENGTH = 1e-12, 1e12  # metres; a value beyond is a mistyped unit
MAX_SIDE = 10**6  # samples; more than any device could hold along two axes
Sign = Literal["any", "positive", "not 0"]

_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+))(?:[eE]([+-]?\d{1,9}))?\s*(\S*)\s*")
_BETWEEN = re.compile(r"[x\u00d7]")


class Length(click.ParamType):
    """Length in metres from text such as 6.6um, 550nm or 24cm; a bare number is in metres."""

    name = "LENGTH"

    def __init__(self, sign: Sign = "any") -> None:
        self.sign = sign

    def get_metavar(self, param: Any, ctx: Any = None) -> str:
        return self.name  # click would turn the x into X

    def convert(self, value: Any, param: Any, ctx: Any) -> float:
        if isinstance(value, float):
            return value
        return self._read(str(value), "", param, ctx)

    def _read(self, text: str, unit: str, param: Any, ctx: Any) -> float:
        """Return a length in metres; a bare number has the unit ``unit``."""
        match = _NUMBER.fullmatch(text)
        power = POWER_OF_TEN.get((match[3] or unit or "m") if match else "")
        if not match or power is None:
            self._refuse(text, param, ctx)
        exponent = int(match[2] or 0) + power  # 6.6um becomes 6.6e-6 to the last bit
        length = float(f"{match[1]}e{exponent}")
        if length and not MIN_LENGTH <= abs(length) <= MAX_LENGTH:
            self.fail(f"{text!r} is out of range: use 1 pm to 1e12 m, or 0.", param, ctx)
        if (self.sign == "positive" and length <= 0) or (self.sign == "not 0" and length == 0):
            condition = "not be 0" if self.sign == "not 0" else f"be {self.sign}"
            self.fail(f"the length must {condition}, got {text!r}.", param, ctx)
        return length

    def _refuse(self, text: str, param: Any, ctx: Any) -> NoReturn:
        comma = "a decimal point, not a comma, and " if "," in text else ""
        self.fail(
            f"{text!r} is not a length: give {comma}a number with a unit, such as 6.6um, 550nm or "
            f"240mm; the units are {', '.join(filter(str.isascii, POWER_OF_TEN))}, and a bare "
            "number is in metres.",
            param,
            ctx,
        )


class Lengths(Length):
    """Pair (y, x) of lengths in metres from YxX such as 5umx6.6um; one length sets both axes."""

    name = "LENGTH or YxX"

    def __init__(self, sign: Sign = "any", *, accepts_single: bool = True) -> None:
        super().__init__(sign)
        self.accepts_single = accepts_single
        if not accepts_single:
            self.name = "YxX"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if isinstance(value, tuple):
            return value
        parts = _BETWEEN.split(str(value))
        if len(parts) > 2 or (len(parts) == 1 and not self.accepts_single):
            self.fail(f"{value!r} is not a pair YxX: give y and x, such as 0x5mm.", param, ctx)
        last = _NUMBER.fullmatch(parts[-1])
        unit = last[3] if last else ""
        lengths = [self._read(part, unit, param, ctx) for part in parts]
        return (lengths[0], lengths[-1])


class Shape(click.ParamType):
    """Number of samples (ny, nx) from N or NYxNX."""

    name = "N or NYxNX"

    def get_metavar(self, param: Any, ctx: Any = None) -> str:
        return self.name

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if isinstance(value, tuple):
            return value
        parts = [part.strip() for part in _BETWEEN.split(str(value))]
        if len(parts) > 2 or not all(part.isascii() and part.isdigit() for part in parts):
            self.fail(
                f"{value!r} is not a number of samples: give a whole number, such as 3030, or "
                "rows and columns, such as 2048x3030.",
                param,
                ctx,
            )
        sides = [int(part) for part in parts]
        if not all(1 <= side <= MAX_SIDE for side in sides):
            self.fail(
                f"{value!r} is out of range: a side has 1 to {MAX_SIDE:,} samples.", param, ctx
            )
        return (sides[0], sides[-1])

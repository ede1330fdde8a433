"""Types and options of several commands: planes, lengths with units, sizes, layouts."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NoReturn

import click
import numpy as np

from clplen.lightfield.depth import best_focus as planes_default

_MOST_PLANES = 10**6
_PATH = click.Path(path_type=Path)


class Planes(click.ParamType):
    """START:STOP:N, N values with both ends included."""

    name = "START:STOP:N"

    def convert(self, value: Any, param: Any, ctx: Any) -> np.ndarray[Any, Any]:
        parts = str(value).split(":")
        try:
            start, stop, count = float(parts[0]), float(parts[1]), int(parts[2])
        except (ValueError, IndexError):
            count = -1
        if len(parts) != 3 or count < 0 or not np.isfinite([start, stop]).all():
            self.fail(f"{value!r} is not START:STOP:N, for example -2:2:33.", param, ctx)
        if count == 0 or (count == 1) != (start == stop):
            self.fail(
                f"{value!r} asks for {planes(count)} from {start:g} to {stop:g}: give at least 2 "
                "planes between two different ends, or 1 plane with START equal to STOP.",
                param,
                ctx,
            )
        if count > _MOST_PLANES:
            self.fail(
                f"{value!r} asks for {planes(count)}, whose places alone fill {8 * count:,} bytes: "
                f"give at most {_MOST_PLANES:,}.",
                param,
                ctx,
            )
        return np.linspace(start, stop, count)


def planes(count: int) -> str:
    """So many planes, in words."""
    return f"{count:,} plane" + ("" if count == 1 else "s")


class Finite(click.ParamType):
    """A number that is neither NaN nor infinite."""

    name = "FLOAT"

    def convert(self, value: Any, param: Any, ctx: Any) -> float:
        try:
            number = float(value)
        except ValueError:
            number = float("nan")
        if not np.isfinite(number):
            self.fail(f"{value!r} is no finite number.", param, ctx)
        return number


FINITE = Finite()


class Aperture(click.ParamType):
    """A number of views, a fraction of the full diameter, or an f-number."""

    name = "N|FRACTION|f/NUMBER"

    def convert(self, value: Any, param: Any, ctx: Any) -> int | float | str:
        text = str(value)
        if text.lower().startswith("f/"):
            return text
        try:
            return float(text) if "." in text else int(text)
        except ValueError:
            self.fail(
                f"{text!r} is no aperture: give a number of views (9), a fraction of the full "
                "diameter (0.5) or an f-number (f/66).",
                param,
                ctx,
            )


class Size(click.ParamType):
    """A number of bytes, with a unit or without."""

    name = "SIZE"
    _pattern = re.compile(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*([kmgt]?)(i?)b?\s*", re.IGNORECASE)

    def convert(self, value: Any, param: Any, ctx: Any) -> int:
        found = self._pattern.fullmatch(str(value))
        size = 0
        if found is not None and (found[2] or not found[3]):
            base = 1024 if found[3] else 1000
            size = int(float(found[1]) * base ** " kmgt".index(found[2].lower() or " "))
        if size < 1:
            self.fail(f"{value!r} is no size: give bytes, or 512MiB, 4GB and so on.", param, ctx)
        return size


def _with_options(*options: Any) -> Callable[[Any], Any]:
    def add(command: Any) -> Any:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def _range(ends: tuple[float, float, int]) -> str:
    return ":".join(f"{number:g}" for number in ends)


device = click.option(
    "--device",
    "selector",
    metavar="DEVICE",
    default=None,
    help="cpu, gpu, platform:device (0:1) or part of a name; default: $CLPLEN_DEVICE, else the "
    "first GPU, else the first CPU. See 'clplen devices'.",
)
memory = click.option(
    "--memory",
    type=Size(),
    help="Read the light field part by part, in so many bytes (512MiB, 4GB) on host and device "
    "together; for those that do not fit.",
)
force = click.option(
    "--force",
    is_flag=True,
    help="Replace outputs that clplen did not write; take a white image whose lattice is not to be "
    "trusted.",
)
force_output = click.option(
    "--force", is_flag=True, help="Replace outputs that clplen did not write."
)
layout = _with_options(
    click.option(
        "--pattern",
        metavar="NAMES",
        help="Names of the views in a folder: {v} and {u} "
        "row and column, or {i} row by row; {n} a counter to ignore; * anything.",
    ),
    click.option(
        "--views",
        type=int,
        nargs=2,
        metavar="V U",
        default=None,
        help="Rows and columns of views, as the names count them.",
    ),
    click.option("--swap-uv", is_flag=True, help="The names count columns before rows."),
    click.option("--flip-v", is_flag=True, help="Reverse the rows of views (after --swap-uv)."),
    click.option("--flip-u", is_flag=True, help="Reverse the columns of views."),
    click.option("--allow-missing", is_flag=True, help="Leave out views that are missing."),
    click.option(
        "--order",
        metavar="AXES",
        help="Axes of an array (uvyxc); of a mosaic yvxu (lenslet images) or vyux (views side by "
        "side); lawnmower for names that count every other row backwards.",
    ),
    click.option(
        "--dataset", metavar="NAME", help="Which array of a file that holds several (HDF5, .mat)."
    ),
    click.option(
        "--positions",
        metavar="CSV|names",
        help="Where the views lie on the aperture, in view steps: a table v,u,y,x, or file names "
        "of the Stanford archive.",
    ),
    click.option("--srgb", is_flag=True, help="Decode sRGB to linear light."),
    click.option("--white", type=_PATH, help="White image of a raw lenslet image."),
    click.option("--dark", type=_PATH, help="Dark frame of a raw lenslet image."),
    click.option(
        "--calibration",
        type=_PATH,
        help="White images of a Lytro camera: folder or tar archive; default: $CLPLEN_LYTRO, or "
        "what was last used for this camera.",
    ),
    click.option("--grid", type=_PATH, help="Lenslet lattice: our JSON or a Raytrix XML."),
    click.option(
        "--trust-lattice",
        is_flag=True,
        help="Take the lattice that was found in a raw image, though it is not to be trusted.",
    ),
    click.option(
        "--intrinsics",
        metavar="FILE",
        type=_PATH,
        help="Of the camera, by 'clplen calibrate': takes the distortion of the views away.",
    ),
    click.option("--step", type=float, help="Pixels a view of a raw image; default: pitch over N."),
    click.option(
        "--lattice",
        type=click.Choice(["square", "hexagonal"]),
        help="Of the lenslets; default: found out.",
    ),
    click.option(
        "--bayer",
        type=click.Choice(["RGGB", "BGGR", "GRBG", "GBRG"], case_sensitive=False),
        help="Colour filters of a raw image.",
    ),
    click.option(
        "--demosaic",
        type=click.Choice(["within", "after", "before"]),
        help="Fit colours within lenslets (default), or interpolate after or before slicing.",
    ),
    click.option(
        "--devignette/--no-devignette",
        default=None,
        help="Divide a raw image by its white image (default where there is one).",
    ),
    click.option(
        "--max-bytes",
        type=int,
        metavar="N",
        help="Largest allocation that a file may ask for; default: half of the free memory.",
    ),
    force,
)
plane_range = _with_options(
    click.option(
        "--disparities",
        type=Planes(),
        help="Planes by disparity, pixels a view step, nearer is larger; default "
        f"{_range(planes_default.DEFAULT_DISPARITIES)} where the spacing is not known.",
    ),
    click.option(
        "--alphas",
        type=Planes(),
        help="Planes by alpha = F/F', where the light field knows its spacing; there the default "
        f"is {_range(planes_default.DEFAULT_ALPHAS)}, at most up to infinity.",
    ),
)


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

"""Pictures on the command line: parameter types, output files and grey-level scaling."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli.shared.console import check_outputs, check_suffix
from clplen.errors import ShapeError

if TYPE_CHECKING:
    from clplen.lightfield.model.light_field import LightField

PICTURES = (".tif", ".tiff", ".png")


class Limits(click.ParamType):
    """Grey-level limits BLACK:WHITE."""

    name = "BLACK:WHITE"

    def convert(self, value: Any, param: Any, ctx: Any) -> tuple[float, float]:
        try:
            black, white = (float(part) for part in str(value).split(":"))
        except ValueError:
            black = white = np.nan
        if not (np.isfinite([black, white]).all() and black < white):
            self.fail(f"{value!r} is not BLACK:WHITE, for example 0:0.8.", param, ctx)
        return black, white


class Curve(click.ParamType):
    """Transfer curve: linear, srgb, log or a gamma."""

    name = "linear|srgb|log|GAMMA"

    def convert(self, value: Any, param: Any, ctx: Any) -> str | float:
        text = str(value).lower()
        if text in ("linear", "srgb", "log"):
            return text
        try:
            gamma = float(text)
        except ValueError:
            gamma = np.nan
        if not (np.isfinite(gamma) and gamma > 0):
            self.fail(f"{value!r} is not a curve: give {self.name}, for example 2.2.", param, ctx)
        return gamma


@dataclass(frozen=True)
class Tone:
    """Limits and curve that scale a PNG; None for the defaults."""

    limits: tuple[float, float] | None = None
    curve: str | float | None = None

    def check(self, output: Path) -> None:
        """Raise an error if a file of linear values should be scaled."""
        if (self.limits or self.curve) and output.suffix.lower() != ".png":
            raise click.UsageError(
                f"--limits and --curve apply to PNG files, but {output} holds linear values: leave "
                "them out, or write .png."
            )


def tone(command: Any) -> Any:
    """Add the options of `Tone`."""
    for option in (
        click.option("--curve", type=Curve(), help="Transfer curve of a PNG from black to white."),
        click.option("--limits", type=Limits(), help="Values shown as black and white in a PNG."),
    ):
        command = option(command)
    return command


depth_map = click.option(
    "--depth-map",
    "depth_file",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Disparity map from 'clplen depth'; every pixel is focused on its disparity.",
)


def read_map(path: Path, lf: LightField) -> np.ndarray[Any, Any]:
    """Read a map with the disparity of every pixel of the views."""
    from clplen.io import read_disparity

    values = read_disparity(path)
    if values.shape != lf.shape[2:4]:
        sizes = [f"{y} x {x}" for y, x in (values.shape, lf.shape[2:4])]
        raise ShapeError(f"{path} has {sizes[0]} pixels (y, x), the views have {sizes[1]}.")
    unknown = np.count_nonzero(~np.isfinite(values))
    if unknown:
        raise ValueError(f"{path} has no disparity at {unknown} pixels: fill them first.")
    return values


class Point(click.ParamType):
    """Pixel Y,X; with ``depth`` also Y,X,D."""

    name = "Y,X"

    def __init__(self, *, depth: bool = False) -> None:
        self._counts = (2, 3) if depth else (2,)
        self.name = "Y,X[,D]" if depth else "Y,X"

    def convert(self, value: Any, param: Any, ctx: Any) -> tuple[float, ...]:
        try:
            numbers = tuple(float(part) for part in str(value).split(","))
        except ValueError:
            numbers = ()
        if len(numbers) not in self._counts or not np.isfinite(numbers).all():
            self.fail(f"{value!r} is not {self.name}, for example 120,88.", param, ctx)
        return numbers


def check_output(source: Path, output: Path, layout: dict[str, Any], suffixes: Any) -> None:
    """Reject an output that cannot be written or is an input."""
    check_suffix(output, suffixes)
    check_outputs(source, layout, output)


def pixel_of(lf: LightField, point: tuple[float, ...]) -> tuple[int, int]:
    """Return the pixel (y, x) of a point, which must lie inside the views."""
    y, x = (round(n) for n in point[:2])
    if not (0 <= y < lf.shape[2] and 0 <= x < lf.shape[3]):
        raise click.UsageError(
            f"The pixel {point[0]:g},{point[1]:g} lies outside the views: Y must be 0 to "
            f"{lf.shape[2] - 1}, X 0 to {lf.shape[3] - 1}."
        )
    return y, x


def write(
    output: Path,
    values: np.ndarray[Any, Any],
    lf: LightField,
    *,
    srgb: bool,
    upsample: int | None = 1,
    brightness: bool = True,
    tone: Tone | None = None,
) -> str:
    """Write a picture, and return a description of the values in the file.

    ``upsample`` is the number of pixels per pixel of a view; None if the axes are not (y, x).
    ``brightness`` is False for a variance, True for values on the scale of the views.
    """
    from clplen.io import write_image

    values = drawable(values)
    if output.suffix.lower() != ".png":
        sizes = None
        if lf.spacing is not None and upsample is not None:
            sizes = (*lf.spacing[:2], lf.spacing[2] / upsample, lf.spacing[3] / upsample)
        write_image(output, values, spacing=sizes, description="linear values")
        return "linear float32"
    dtype = lf.dtype if brightness else np.dtype(np.float32)
    return write_preview(output, values, dtype, srgb=srgb and brightness, tone=tone)


def write_preview(
    output: Path,
    values: np.ndarray[Any, Any],
    dtype: np.dtype[Any],
    *,
    srgb: bool = False,
    tone: Tone | None = None,
) -> str:
    """Write an 8-bit picture for viewing, and return a description of its scaling.

    ``dtype`` is the type of the original samples, float32 for values other than brightness.
    """
    from clplen.io import write_picture
    from clplen.io.formats.animation import toned, white_level

    tone = tone or Tone()
    black, white = tone.limits or (0.0, white_level(values, dtype, srgb=srgb))
    curve = tone.curve or ("srgb" if srgb else "linear")
    write_picture(output, toned(values, black, white, curve))
    above = np.count_nonzero(values > white)
    description = describe_scaling(white, curve, black)
    return description + (f"; {above} samples are brighter" if above else "")


def check_film(source: Path, output: Path, layout: dict[str, Any]) -> None:
    """Reject a film that cannot be written, before its frames are computed."""
    from clplen.io.formats.animation import FILMS
    from clplen.io.formats.video import encoder

    check_output(source, output, layout, FILMS)
    if output.suffix.lower() == ".mp4":
        encoder()


def animate(
    output: Path,
    frames: np.ndarray[Any, Any],
    dtype: np.dtype[Any],
    *,
    srgb: bool = False,
    seconds: float | None = None,
) -> str:
    """Write pictures (n, y, x[, c]) as a GIF or film with one scaling, and return its text."""
    from clplen.io.formats.animation import to_eight_bits, white_level, write_animation

    white = white_level(frames, dtype, srgb=srgb)
    drawable(frames[0])
    pictures = [drawable(to_eight_bits(frame, white, srgb=srgb)) for frame in frames]
    timing = {} if seconds is None else {"seconds": seconds}
    write_animation(output, pictures, **timing)
    return f"{len(pictures)} frames, {describe_scaling(white, 'srgb' if srgb else 'linear')}"


def describe_scaling(white: float, curve: str | float = "linear", black: float = 0.0) -> str:
    """Return a description of the scaling to 8 bits."""
    dark = f"{black:.6g} is black, " if black else ""
    names = {"linear": "", "srgb": ", encoded as sRGB", "log": ", logarithmic"}
    by = names.get(str(curve), f", gamma {curve}")
    return f"scaled for viewing ({dark}{white:.6g} is white{by}), not for measurements"


def drawable(values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return pictures (..., y, x) or (..., y, x, 3); drop the axis of a single channel."""
    if values.ndim >= 3 and values.shape[-1] == 1:
        values = values[..., 0]
    if values.ndim == 3 and values.shape[-1] != 3:
        raise ShapeError(
            f"A picture file holds one or three channels, but this light field has "
            f"{values.shape[-1]}: select channels with clplen.LightField in Python."
        )
    return values

"""Raw images of focused (plenoptic 2.0) cameras on the command line: what tells them, and words."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli import options

if TYPE_CHECKING:
    from clplen.lightfield.raw.raw_image import RawImage

Values = np.ndarray[Any, Any]

_XML = (".xml", ".ray")
_LAYOUT = ("white", "dark", "grid", "step", "devignette", "max_bytes")
_SUCH = (
    "raw images of focused cameras: raw.h5 of 'clplen simulate', a Raytrix XML, or a raw picture "
    "with --white or --grid"
)
_SPREAD = (2, 98)  # per cent of the sub-images that default planes hold
_WIDER, _LEAST = 1.1, 0.1  # of their half range, and of their middle


class Magnifications(click.ParamType):
    """m = b/a: one number, several, or START:STOP:N."""

    name = "M|M,M,...|START:STOP:N"

    def convert(self, value: Any, param: Any, ctx: Any) -> Values:
        text = str(value)
        if ":" in text:
            planes = options.Planes().convert(text, param, ctx)
            if (planes == 0).any():
                self.fail(
                    f"{text!r} passes m = 0, where nothing is in focus: give planes on one side "
                    "of 0, or a count that leaves it out.",
                    param,
                    ctx,
                )
            return planes
        try:
            numbers = np.array([float(part) for part in text.split(",")])
        except ValueError:
            numbers = np.array([np.nan])
        if not np.isfinite(numbers).all():
            self.fail(f"{text!r} is not m: give 0.2, 0.1,0.2 or 0.1:0.3:9.", param, ctx)
        return numbers


class Range(click.ParamType):
    """LEAST:GREATEST."""

    name = "LEAST:GREATEST"

    def convert(self, value: Any, param: Any, ctx: Any) -> tuple[float, float]:
        try:
            low, high = (float(part) for part in str(value).split(":"))
        except ValueError:
            self.fail(f"{value!r} is not LEAST:GREATEST, for example 0.1:0.3.", param, ctx)
        return low, high


def _with(*more: Any) -> Any:
    def add(command: Any) -> Any:
        for option in reversed((*more, _FOCUSED, _IMAGE)):
            command = option(command)
        return command

    return add


_FOCUSED = click.option(
    "--focused",
    is_flag=True,
    help="INPUT is a raw image of a focused (plenoptic 2.0) camera; raw.h5 and a Raytrix XML tell "
    "by themselves.",
)
_IMAGE = click.option(
    "--image",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Picture that belongs to a Raytrix XML; default: the one of the same name.",
)
_VIEW = click.option(
    "--view",
    type=options.FINITE,
    nargs=2,
    metavar="Y X",
    help="Of a focused raw image: pixels in the sub-images, another place on the main lens.",
)
_PLANES = click.option(
    "--m",
    "ms",
    type=Magnifications(),
    help="Of a focused raw image: planes in focus by m = b/a, START:STOP:N or 0.1,0.2; default: "
    "11 that suit it.",
)
picture_words = _with(
    click.option(
        "--method",
        type=click.Choice(["basic", "blended", "depth"]),
        help="Of a focused raw image: one patch a lenslet, the mean of all that see a point "
        "(default), or that with the m of each place.",
    ),
    click.option(
        "--m",
        "ms",
        type=Magnifications(),
        help="Of a focused raw image: plane in focus by m = b/a; default: the camera's, else the "
        "median. With --sweep focus several, START:STOP:N.",
    ),
    click.option(
        "--patch",
        type=options.FINITE,
        help="Of a focused raw image: pixels across a patch; default: those that m has.",
    ),
    _VIEW,
)
stack_words = _with(_PLANES, _VIEW)
depth_words = _with(
    click.option(
        "--m",
        "ms",
        type=Range(),
        help="Of a focused raw image: range of m = b/a to look through.",
    )
)


@dataclass(frozen=True)
class Opened:
    """A raw image and the white image of its camera, where one is given."""

    raw: RawImage
    white: Values | None

    @property
    def flat(self) -> Values | None:
        """The white image, of one channel."""
        return self.white.mean(2) if self.white is not None and self.white.ndim == 3 else self.white


def is_meant(source: Path, words: dict[str, Any]) -> bool:
    """Whether INPUT is a raw image of a focused camera: it tells, or a word that only those take.

    Raises
    ------
    UsageError
        If such a word is given with something else.
    """
    from clplen.io.lightfields.lightfield_files import kind_of

    if tells(source):
        return True
    given = [name for name, value in words.items() if value is not None and value is not False]
    if not given:
        return False
    kind = kind_of(source)
    if "white" not in kind.words:
        raise click.UsageError(f"--{given[0]} is for {_SUCH}; {source} is {kind.name}.")
    return True


def tells(source: Path) -> bool:
    """Whether a file says by itself that it is a raw image, and where its lenslets are."""
    from clplen.io import is_raw_file

    return source.suffix.lower() in _XML or is_raw_file(source)


def refuse(**words: Any) -> None:
    """Refuse words that are for light fields.

    Raises
    ------
    UsageError
        Naming the first that is given.
    """
    given = [name for name, value in words.items() if value is not None and value is not False]
    if given:
        raise click.UsageError(
            f"--{given[0].replace('_', '-')} is for light fields; this is a raw image of a focused "
            "camera, whose planes are given by --m, b/a."
        )


def check_kept(source: Path, image: Path | None, *outputs: Path) -> None:
    """Refuse outputs that would replace the picture that belongs to a Raytrix XML.

    Raises
    ------
    UsageError
        Naming the output.
    """
    from clplen.io.raw.raw_files import picture_of

    if source.suffix.lower() not in _XML:
        return
    picture = picture_of(source) if image is None else image
    for output in outputs:
        if output.exists() and picture.exists() and picture.samefile(output):
            raise click.UsageError(
                f"{output} is the raw image of {source}: name an output elsewhere."
            )


def read(source: Path, selector: str | None, layout: dict[str, Any], image: Path | None) -> Opened:
    """The raw image with its lattice; with ``--grid`` the white image only evens it.

    Raises
    ------
    UsageError
        If files are given that it does not need.
    """
    from clplen.compute.device import Device
    from clplen.io import read_raw
    from clplen.io.lightfields.layout import Layout
    from clplen.lightfield.focused.focused_geometry import require_focused

    Layout(**layout).require(_LAYOUT, "a raw image of a focused camera")
    white, dark, grid = (layout[name] for name in ("white", "dark", "grid"))
    device = Device.open(selector)
    if tells(source):
        if dark is not None or grid is not None:
            raise click.UsageError(
                f"--dark and --grid do not apply to {source}, which tells its lenses: leave out."
            )
        raw = read_raw(source, device=device, image=image)
    else:
        found_on = white if grid is None else None
        raw = read_raw(
            source,
            device=device,
            image=image,
            white=found_on,
            dark=dark,
            grid=grid,
            force=layout["force"],
        )
    require_focused(raw)
    return Opened(raw, None if layout["devignette"] is False else _white(white, dark))


def _white(white: Path | None, dark: Path | None) -> Values | None:
    from clplen.io.raw.raw_files import read_frame

    if white is None:
        return None
    values = read_frame(white)[0].astype(np.float32)
    return values if dark is None else values - read_frame(dark)[0].astype(np.float32)


def suitable_ms(opened: Opened, count: int) -> Values:
    """Planes that hold what the sub-images show, equidistant in m.

    Raises
    ------
    ValueError
        If there is no texture to tell them by.
    """
    from clplen.lightfield.focused.focused_depth import focused_depth

    depth = focused_depth(opened.raw, white=opened.flat)
    median = depth.median  # says so where nothing is sure
    low, high = np.percentile(depth.m[depth.confidence >= depth.sure], _SPREAD)
    half = max(_WIDER * (high - low) / 2, _LEAST * abs(median))
    return np.linspace((low + high) / 2 - half, (low + high) / 2 + half, count)


def fraction(aperture: Any) -> float:
    """The share of a sub-image's diameter.

    Raises
    ------
    UsageError
        For an f-number.
    """
    if isinstance(aperture, str):
        raise click.UsageError(
            "--aperture of a focused raw image is a share of a sub-image's diameter, such as 0.5, "
            f"not {aperture}."
        )
    return 1.0 if aperture is None else float(aperture)
